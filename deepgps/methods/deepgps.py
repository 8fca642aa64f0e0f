"""DeepGPS: a network that learns positions from images and distances driven along straight segments, nothing else.

The paper's loss (Eq. 2, 3, 5) has many minima in which the map lies folded on itself. So training starts unfolded: from
a ``first_map``, shortest paths made exact, which the network imitates, or, where segments have only two readings, from
more output dimensions than two ("lifting"), which are flattened later. A fold found all the same restarts training,
then by lifting.
"""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch

from deepgps.data.encoder_noise import expect_errors, find_believed, trust_pairs, trust_places
from deepgps.data.plausible_readings import count_readings
from deepgps.data.segments import Segments, spread
from deepgps.initial_map.dense import find_first_map
from deepgps.initial_map.end_points import find_end_map
from deepgps.initial_map.fold_detector import Signs, find_signs
from deepgps.initial_map.isomap import has_lines
from deepgps.initial_map.wheel_turns import find_hand, read_turns, straighten
from deepgps.learning import losses
from deepgps.learning.batches import Batch, draw
from deepgps.learning.networks import count_parameters
from deepgps.learning.trainer import Loss, derive_seed, make_generator, predict, train
from deepgps.learning.training_data import Material, new_network, prepare
from deepgps.methods.positioner import (
    NetworkPositioner,
    Positioner,
    as_positioner,
    is_finished,
    load_positioner,
    save_positioner,
)
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings, LiftSettings, Start
from sim.errors import InputError
from sim.files import remove_files, write_bytes
from sim.recording.format import Recording

ATTEMPT = re.compile(r"history\.npz|checkpoint\.pt")
IMITATE = 0.2  # fraction of the steps in which the first map is imitated, less and less
FIRST_MAP = {"paths": find_first_map, "ends": find_end_map}
# How far predictions may stay from the first map unpunished [m]: about what it is wrong by, of ends at single places.
SLACK_M = {"paths": 0.03, "ends": 1.0}


@dataclass(frozen=True)
class Attempt:
    """One training and its map.

    Attributes:
        positioner: What was learned.
        signs: Signs of a fold in it.
        seconds: What the training took.
    """

    positioner: NetworkPositioner
    signs: Signs
    seconds: float


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train DeepGPS into ``folder``; done work is loaded, cut-off work continued."""
    return _fit(recording, settings, seed, folder, progress, lambda material: material)


def fit_aware(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """The same, with residuals divided by what encoders are expected to be wrong by, and doubtful segments found."""

    def expect(material: Material) -> Material:
        return replace(material, segments=expect_errors(recording, material.segments))

    return _fit(recording, settings, seed, folder, progress, expect)


def fit_turns(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """The same from the path that the wheels reckon, with left and right as they turned: no mirrored map."""

    def add_turns(material: Material) -> Material:
        return replace(material, turns=read_turns(recording))

    return _fit(recording, settings, seed, folder, progress, add_turns)


def _fit(
    recording: Recording,
    settings: LearnSettings,
    seed: int,
    folder: Path,
    progress: Report,
    extend: Callable[[Material], Material],
) -> Positioner:
    if not is_finished(folder):
        material = extend(prepare(recording, settings, seed, folder.parent))
        attempts = run_attempts(material, settings, seed, folder, progress)
        best = min(range(len(attempts)), key=lambda number: attempts[number].signs.worst(settings.fold))
        chosen = attempts[best]
        write_bytes(folder / "history.npz", (_attempt_folder(folder, best) / "history.npz").read_bytes())
        training = {
            "steps": settings.train.steps * len(attempts),
            "train_s": round(sum(attempt.seconds for attempt in attempts), 1),
            "parameters": count_parameters(chosen.positioner.network),
            "attempts": len(attempts),
            "fold": {"found": chosen.signs.folded(settings.fold), **asdict(chosen.signs)},
            **count_readings(recording),
            "segments_skipped": material.segments.skipped,
            "segments_doubted": len(material.segments.count) - len(find_believed(material.segments).count),
        }
        save_positioner(folder, chosen.positioner, training)
    for number in range(settings.fold.restarts + 1):
        remove_files(_attempt_folder(folder, number), ATTEMPT)
    return load_positioner(folder)


def run_attempts(
    material: Material, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> list[Attempt]:
    """Train until a map shows no fold, or the restarts are used up."""
    attempts = []
    for number in range(settings.fold.restarts + 1):
        label = folder.name if number == 0 else f"{folder.name}, restart {number}"
        attempts.append(run_attempt(material, settings, seed, number, _attempt_folder(folder, number), progress, label))
        if not attempts[-1].signs.folded(settings.fold):
            break
    return attempts


def run_attempt(
    material: Material,
    settings: LearnSettings,
    seed: int,
    number: int,
    folder: Path,
    progress: Report = ignore,
    label: str = "deepgps",
) -> Attempt:
    """Train once, from the weights and draws of attempt ``number``, and look for folds."""
    start = choose_start(settings, material.segments, number)
    network = new_network(material, settings, settings.lift.dimensions if start == "lifting" else 2, seed, number)
    device = material.inputs.table.device
    segments = material.segments.to(device)
    sample, chosen = spread(find_believed(material.segments), len(material.features))
    features, near, numbers = material.features[chosen], sample.to(device), chosen.to(device)

    def draw_batch(generator: torch.Generator, done: float) -> Batch:
        if start in FIRST_MAP and done < IMITATE:  # only these have a place on the first map
            batch = draw(near, settings.train.segments, settings.train.samples, generator)
            return replace(batch, index=numbers[batch.index])
        return draw(segments, settings.train.segments, settings.train.samples, generator)

    loss = segment_loss(settings, segments.rounding_m2)
    if start in FIRST_MAP:
        first = torch.full((len(material.features), 2), torch.nan)
        if material.turns and start == "paths" and number == 0:
            places = straighten(material.turns, chosen, features, sample)
        else:
            places = FIRST_MAP[start](features, sample, make_generator(seed, "start", number))
        first[chosen] = torch.from_numpy(places).float()
        loss = imitate_first(loss, first.to(device), SLACK_M[start])
    elif start == "lifting":
        loss = flatten_later(loss, settings.lift)
    draws = derive_seed(seed, "shuffling", number)
    seconds = train(network, material.inputs, draw_batch, loss, settings.train, draws, folder, progress, label)
    out = predict(network, material.inputs, chosen)
    centre, axes = find_plane(out)
    positions = ((out - centre) @ axes).double().numpy()
    signs = find_signs(positions, features, sample, make_generator(seed, "fold", number))
    if material.turns:
        out = predict(network, material.inputs, torch.arange(len(material.features)))
        hand = find_hand(((out - centre) @ axes).double().numpy(), material.segments, material.turns)
        axes = axes * torch.tensor([1.0, hand])
    return Attempt(as_positioner(material, settings, network, centre, axes), signs, seconds)


def choose_start(settings: LearnSettings, segments: Segments, number: int = 0) -> Start:
    """How attempt ``number`` unfolds: ``auto`` takes paths where segments are long enough, else and later lifting."""
    if settings.start == "auto":
        return "paths" if number == 0 and has_lines(segments) else "lifting"
    if settings.start == "paths" and not has_lines(segments):
        raise InputError(
            "learn.start 'paths': most segments have only two readings; auto and lifting can learn from those"
        )
    return settings.start


def segment_loss(settings: LearnSettings, rounding_m2: float = 0.0) -> Loss:
    """The paper's dense loss (Eq. 5), and ours of straightness with its weight; errors that are expected count less."""

    def both(out: torch.Tensor, batch: Batch, done: float) -> torch.Tensor:
        of_pairs = of_places = None
        if batch.variance is not None:
            of_pairs = trust_pairs(batch.variance, rounding_m2)
            of_places = trust_places(batch.variance, batch.valid, rounding_m2)
        pairs = losses.dense(out, batch.target, batch.valid, settings.loss, of_pairs)
        if settings.straight == 0.0:
            return pairs
        return pairs + settings.straight * losses.straight(out, batch.target, batch.valid, of_places)

    return both


def imitate_first(loss: Loss, known: torch.Tensor, slack_m: float) -> Loss:
    """Pull predictions towards a first map: at once and wholly, later only those farther than ``slack_m`` from it.

    Args:
        loss: What takes over until ``IMITATE`` of the steps.
        known: First map (N, 2) [m]; not a number for observations that have no place on it.
        slack_m: About what the first map is wrong by [m].
    """
    mapped = known.isfinite().all(dim=1)

    def both(out: torch.Tensor, batch: Batch, done: float) -> torch.Tensor:
        pull = max(0.0, 1.0 - done / IMITATE)
        told = batch.valid & mapped[batch.index]
        away = losses.distance(out[told], known[batch.index[told]])
        count = max(1, len(away))
        imitation, leash = away.sum() / count, (away - slack_m).clamp_min(0.0).sum() / count
        return (1.0 - pull) * (loss(out, batch, done) + leash) + pull * imitation

    return both


def flatten_later(loss: Loss, lift: LiftSettings) -> Loss:
    """Add, more and more, the mean distance of predictions from the plane of their two principal axes."""

    def both(out: torch.Tensor, batch: Batch, done: float) -> torch.Tensor:
        push = lift.penalty * min(
            1.0, max(0.0, (done - lift.flatten_from) / max(lift.flatten_to - lift.flatten_from, 1e-9))
        )
        if push == 0.0:
            return loss(out, batch, done)
        points = out[batch.valid]
        centre, axes = find_plane(points.detach())
        points = points - centre
        return loss(out, batch, done) + push * losses.distance(points, points @ axes @ axes.T).mean()

    return both


def find_plane(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Centre (D,) and two principal axes (D, 2) of points (n, D); two dimensions stay as they are."""
    if points.shape[1] == 2:
        return torch.zeros_like(points[0]), torch.eye(2, dtype=points.dtype, device=points.device)
    centre = points.mean(dim=0)
    _, axes = torch.linalg.eigh((points - centre).T @ (points - centre))
    return centre, axes[:, -2:]


def _attempt_folder(folder: Path, number: int) -> Path:
    return folder / f"attempt{number}"
