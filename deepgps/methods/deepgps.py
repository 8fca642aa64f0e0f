"""DeepGPS: a network that learns positions from images and distances driven along straight segments, nothing else.

``train_attempt`` is the method, step by step. The paper's loss (Eq. 2, 3, 5) has many minima in which the map is folded
onto itself. So training needs an unfolded start: an initial map, which the network imitates at first, or, where
segments have only two readings, more than two output dimensions, which are flattened later. If a map is folded all the
same, training is repeated with lifting. The initial map also shows how noisy the encoders are, and the network learns
from distances that it corrects as far. The network's task and the loss are the paper's; the starts, the correction and
the fold detector are ours.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepgps.config.learning import LearnSettings, Start
from deepgps.data.segments import Segments, find_stretches, subsample
from deepgps.initial_map.distances.dense import find_initial_map
from deepgps.initial_map.distances.end_points import find_end_point_map
from deepgps.initial_map.distances.folding import FoldScore, find_ambiguous, score_folding
from deepgps.initial_map.distances.isomap import has_lines
from deepgps.learning import losses
from deepgps.learning.batches import Batch, Loss, sample_from
from deepgps.learning.checkpoint import NAME as CHECKPOINT
from deepgps.learning.losses import find_plane, flatten_later, imitate_first, sample_mapped_first
from deepgps.learning.networks import count_parameters
from deepgps.learning.trainer import make_generator, predict, train
from deepgps.learning.training_data import TrainingData, new_network, prepare
from deepgps.positioner.positioner import Fitted, NetworkPositioner, as_positioner
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.files.atomic import remove_files, write_bytes
from sim.recording.format import Recording
from sim.rng import derive_seed

INITIAL_MAPS = {"paths": find_initial_map, "ends": find_end_point_map}
"""Functions (features, segments, generator) -> positions, and the segments with corrected distances."""
SLACK_M = {"paths": 0.03, "ends": 1.0}
"""Distance from the initial map that is not penalised [m]: about the map's error, which is large for end points."""
HISTORY = "history.npz"
FOLDER = re.compile(r"attempt\d+")
FILES = re.compile(rf"{re.escape(HISTORY)}|{re.escape(CHECKPOINT)}")


def make_initial_map(
    features: torch.Tensor, segments: Segments, start: Start, seed: int, number: int
) -> tuple[torch.Tensor, Segments]:
    """Positions (N, 2) [m] without a network: by straightness or shortest paths, refined, or from segments' ends.

    They are NaN where they are unknown, as for what a long recording has beyond the sample that is mapped. Also the
    segments, with distances corrected by the map, unless it is of a sample or of end points.
    """
    generator = make_generator(seed, "start", number)
    sample, chosen = subsample(segments, len(features))
    places = torch.full((len(features), 2), torch.nan, dtype=torch.float64)
    found, corrected = INITIAL_MAPS[start](features[chosen], sample, generator)
    places[chosen] = torch.from_numpy(found)
    return places, corrected if sample is segments else segments


@dataclass(frozen=True)
class Attempt:
    """One training and its map."""

    number: int  # Its number, counted from 0
    positioner: NetworkPositioner  # The trained network
    score: FoldScore  # How far its map is folded
    ambiguous: np.ndarray  # Observations that could be mirrored, as far as distances tell (N,) bool
    seconds: float  # Duration of the training


def remove_leftovers(folder: Path) -> None:
    """Remove the files of attempts and the checkpoint from a method's folder; a finished training needs neither."""
    for attempt in folder.glob("attempt*"):
        if FOLDER.fullmatch(attempt.name):
            remove_files(attempt, FILES)
    (folder / CHECKPOINT).unlink(missing_ok=True)


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train DeepGPS on images and distances alone until a map shows no fold or no restart is left; the best is kept."""
    data, attempts = prepare(recording, settings, seed, folder.parent, progress=progress), []
    for number in range(settings.fold.restarts + 1):
        attempts.append(train_attempt(data, settings, seed, number, folder / f"attempt{number}", progress))
        if not attempts[-1].score.folded:
            break
    best = min(attempts, key=lambda attempt: attempt.score.worst)
    write_bytes(folder / HISTORY, (folder / f"attempt{best.number}" / HISTORY).read_bytes())
    training = {
        "steps": settings.train.steps * len(attempts),  # Steps of all attempts
        "train_s": round(sum(attempt.seconds for attempt in attempts), 1),  # Seconds of all attempts
        "parameters": count_parameters(best.positioner.network),  # Parameters of the network
        "attempts": len(attempts),  # Number of attempts
        "attempt": best.number,  # The one that was chosen, counted from 0
        # Verdict of the fold detector, which does not see the truth, and the measures behind it
        "fold": best.score.record(),
        "map": record_undecided(best.ambiguous),  # What is undecided of the map
        "segments_skipped": data.segments.skipped,  # Segments that were not used
    }
    return Fitted(best.positioner, training)


def train_attempt(
    data: TrainingData, settings: LearnSettings, seed: int, number: int, folder: Path, progress: Report
) -> Attempt:
    """Train once: the method from its input to its map; attempts are counted from 0."""
    # 1. The input: segments of known length, and features that change slowly along them (ours).
    segments = data.segments
    # 2. The network from an image to a position (Sec. III), with more outputs where lifting unfolds the map (ours).
    start, label = choose_start(settings, segments, number), folder.parent.name
    label += f", restart {number}" if number else ""
    network = new_network(data, settings, settings.lift.dimensions if start == "lifting" else 2, seed, number)
    # 3. The loss: distances on the map equal those driven (Eq. 2, 3, 5), and segments are straight (ours).
    loss = segment_loss(settings)
    # 4. An unfolded start, which also corrects the distances of noisy encoders (ours).
    if start in INITIAL_MAPS:
        progress(f"{label}: initial map", 0, 1)
        places, corrected = make_initial_map(data.features, segments, start, seed, number)
        known, learned = places.float(), corrected.learned
        progress(f"{label}: initial map", 1, 1)
        loss = imitate_first(loss, known.to(data.device), SLACK_M[start])
        mapped = learned.through(known.isfinite().all(dim=1))
        draw = sample_mapped_first(*(sample_from(some.to(data.device), settings.train) for some in (learned, mapped)))
    else:
        draw = sample_from(segments.learned.to(data.device), settings.train)
        if start == "lifting":
            loss = flatten_later(loss, settings.lift)
    # 5. Gradient descent.
    shuffling = derive_seed(seed, "shuffling", number)
    seconds = train(network, data.inputs, draw, loss, settings.train, shuffling, folder, progress, label)
    # 6. The map, which is a plane in the network's output, and whether it is folded or could be (ours).
    out = predict(network, data.inputs, torch.arange(len(data.features)))
    centre, axes = find_plane(out)
    places = (out - centre) @ axes
    score = score_folding(places.double().numpy(), data.features, segments, make_generator(seed, "fold", number))
    ambiguous = np.zeros(len(places), bool)
    if has_lines(segments):
        ambiguous = find_ambiguous(places.double().numpy(), data.features, segments)
    return Attempt(number, as_positioner(data, settings, network, centre, axes), score, ambiguous, seconds)


def record_undecided(undecided: np.ndarray) -> dict[str, Any]:
    """What ``training.json`` holds of a mask (N,) of observations that may lie elsewhere: share, ends of each part."""
    # Share of the observations that may lie elsewhere; first and last of each such part
    return {"undecided": round(float(undecided.mean()), 4), "parts": find_stretches(undecided).tolist()}


def choose_start(settings: LearnSettings, segments: Segments, number: int = 0) -> Start:
    """Choose the start of an attempt: ``auto`` is paths at first, where a map can be made, and else lifting.

    Raises InputError if the start is set to paths, and no map can be made.
    """
    enough = has_lines(segments)
    if settings.start == "auto":
        return "paths" if number == 0 and enough else "lifting"
    if settings.start == "paths" and not enough:
        raise InputError(
            "learn.start 'paths': most segments have only two readings; auto and lifting can learn from those"
        )
    return settings.start


def segment_loss(settings: LearnSettings) -> Loss:
    """The paper's dense loss (Eq. 5) plus our loss of straightness times its weight."""

    def both(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        pairs = losses.dense(out, batch.target, batch.valid, settings.loss)
        if settings.straight == 0.0:
            return pairs
        return pairs + settings.straight * losses.straight(out, batch.target, batch.valid)

    return both
