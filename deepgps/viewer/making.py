"""Maps in the making: the initial map by compass, and how trainings unfold theirs, with the loss below ``training``.

The initial map has its path, turns and loop closures at each stage, and errors at the end. Every stage is aligned with
the last, and that with the true places; without truth, the map is in its own frame. Trainings in progress are logged
part by part, by the same functions.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from deepgps.config.methods import folder_of
from deepgps.data.segments import find_starts
from deepgps.evaluation.map_errors import read_known_map
from deepgps.initial_map.stored_map import StoredMap
from deepgps.reports import plots
from deepgps.viewer.scene import LAYER_M, colours_of_places, draw_ellipses, lift
from deepgps.viewer.stream import (
    MAP_STAGE,
    STEP,
    Rows,
    Span,
    find_span,
    put,
    put_text,
    send_rows,
    send_series,
    start_row,
    step_rows,
)
from sim.alignment import Alignment, fit_alignment
from sim.recording.format import Recording

MAP_ENTITY, TEXT_ENTITY = "world/making", "making"
History = Mapping[str, np.ndarray]
PATH_COLOUR, WARNING_COLOUR, TURN_COLOUR = (90, 160, 255), (255, 150, 40), (255, 230, 120)
INLIER_COLOUR, OUTLIER_COLOUR, OPEN_COLOUR = (63, 208, 165), (232, 37, 79), (120, 130, 150)
ARC_M, ARC_POINTS = 0.06, 12
MAX_ELLIPSES, SIGMAS, MIN_HALF_AXIS_M = 100, 2.0, 0.06
"""Most ellipses, standard deviations, and the half axis up to which the middle one is enlarged [m]."""
LEGEND = (
    "Blue: path; orange: parts that stay undecided. Yellow arcs: turns, by the two images before and after; point at "
    "one for its angle. Green: loop closures that are inliers; red: refused; grey: not judged yet. Each stage is "
    "aligned with the last."
)


def find_map(run: Path, methods: Iterable[str]) -> StoredMap | None:
    """The initial map of the first of the methods that kept it; None if none did."""
    return next((stored for name in methods if (stored := read_known_map(folder_of(run, name))) is not None), None)


def log_making(stream: rr.RecordingStream, stored: StoredMap, recording: Recording, place: np.ndarray | None) -> None:
    """Log every stage of a map's making, beside the true positions of the observations (N, 2) [m] if known."""
    known = stored.known
    upon = stored.places if place is None else place
    world = fit_alignment(stored.places[known], upon[known], "SE2")
    final = world.apply(stored.places)
    segment = find_starts(recording.reading[:, 0])
    rows = np.split(recording.reading[:, 1], np.flatnonzero(np.diff(segment)) + 1)
    last = len(stored.stage) - 1
    for stage in range(last + 1):
        at = [rr.TimeColumn(MAP_STAGE, sequence=[stage]), *(start_row(find_span(recording)) if stage == last else [])]
        own = fit_alignment(stored.stage_places[stage][known].astype(float), final[known], "SE2")
        places = own.apply(stored.stage_places[stage].astype(float))
        heading = own.turn(stored.stage_heading[stage].astype(float))
        off_m = None if place is None else float(np.sqrt(((places - place)[known] ** 2).sum(axis=1).mean()))
        words, larger = _describe(stored, stage, off_m), enlarge(stored)
        drawn = [
            *_draw_path(places, rows, stored.undecided),
            _draw_turns(stored, places, heading),
            *_draw_closures(stored, places, stage),
        ]
        if stage == last:
            drawn.append(_draw_ellipses(stored, world, larger))
            size = f"drawn {larger:g} times as large" if larger > 1.0 else "at their true size"
            words += [f"Ellipses: {SIGMAS:g} standard deviations, {size}."]
        for name, strips, radius_m, colours, said in drawn:
            put(stream, f"{MAP_ENTITY}/{name}", rr.LineStrips3D(strips, radii=radius_m, colors=colours), at, said)
        put_text(stream, TEXT_ENTITY, "\n\n".join([*words, LEGEND]), at)


Lines = tuple[str, list[np.ndarray], float, Any, dict[str, list[str]]]
"""Entity, lines (n, 3) [m], their radius [m] and colours, and what the tooltip says of each, by its name."""


def _draw_path(places: np.ndarray, rows: list[np.ndarray], undecided: np.ndarray) -> Iterator[Lines]:
    """The segments, those that end undecided in a colour of their own."""
    strips = {"path": [], "undecided": []}
    for row in rows:
        points = row[np.isfinite(places[row, 0])]
        if len(points) > 1:
            strips["undecided" if undecided[points].mean() > 0.5 else "path"].append(lift(places[points], LAYER_M))
    for name, colour in (("path", PATH_COLOUR), ("undecided", WARNING_COLOUR)):
        yield name, strips[name], 0.004, [colour], {}


def _draw_turns(stored: StoredMap, places: np.ndarray, heading: np.ndarray) -> Lines:
    """An arc at each turn, from the heading before to the heading after, with a stroke along the latter."""
    before = stored.turn[:, 0]
    shown = np.isfinite(places[before, 0])
    before, angle, std = before[shown], stored.turn_angle[shown], np.degrees(stored.turn_std[shown])
    sweep = heading[before, None] + angle[:, None] * np.linspace(0.0, 1.0, ARC_POINTS)
    arcs = places[before, None] + ARC_M * np.stack([np.cos(sweep), np.sin(sweep)], axis=2)
    strips = np.concatenate([arcs, places[before, None]], axis=1)
    said = [f"{one:+.1f}° ± {err:.2f}°" for one, err in zip(np.degrees(angle), std, strict=True)]
    return "turns", [lift(strip, 2 * LAYER_M) for strip in strips], 0.003, [TURN_COLOUR], {"turned": said}


def _draw_closures(stored: StoredMap, places: np.ndarray, stage: int) -> Iterator[Lines]:
    """A line between the two ends of each loop closure; before the first round, none is judged."""
    ends = places[stored.closure]
    shown, inliers = np.isfinite(ends).all(axis=(1, 2)), stored.stage_believed[stage]
    for name, chosen, colour in (
        ("refused", shown & ~inliers, OPEN_COLOUR if stored.stage[stage] == 0 else OUTLIER_COLOUR),
        ("inliers", shown & inliers, INLIER_COLOUR),
    ):
        apart = np.linalg.norm(ends[chosen, 0] - ends[chosen, 1], axis=1)
        turned = np.degrees(stored.closure_turn[chosen])
        said = [
            f"images {one} and {other}, {100 * away:.0f} cm apart" + ("" if np.isnan(angle) else f", {angle:+.1f}°")
            for (one, other), away, angle in zip(stored.closure[chosen], apart, turned, strict=True)
        ]
        yield name, [lift(pair, 3 * LAYER_M) for pair in ends[chosen]], 0.003, [colour], {"alike": said}


def _draw_ellipses(stored: StoredMap, world: Alignment, larger: float) -> Lines:
    known = np.flatnonzero(stored.known)
    some = known[np.linspace(0, len(known) - 1, min(MAX_ELLIPSES, len(known))).astype(int)]
    covariance = (SIGMAS * larger) ** 2 * world.rotation @ stored.covariance[some] @ world.rotation.T
    strips = draw_ellipses(world.apply(stored.places[some]), covariance, 4 * LAYER_M)
    colours = np.where(stored.undecided[some, None], WARNING_COLOUR, (255, 255, 255)).astype(np.uint8)
    said = [f"± {100 * one:.2f} cm (RMS)" for one in stored.expected[some]]
    return "ellipses", list(strips), 0.004, colours, {"expected": said}


def enlarge(stored: StoredMap) -> float:
    """How many times larger ellipses are drawn so that the middle one can be seen: 1, 2, 5, 10, 20, ..."""
    middle = SIGMAS * float(np.median(stored.expected[stored.known])) / np.sqrt(2.0)
    steps = np.outer(10.0 ** np.arange(4), [1.0, 2.0, 5.0]).ravel()
    return float(steps[max(np.searchsorted(steps, MIN_HALF_AXIS_M / max(middle, 1e-9), "right") - 1, 0)])


def _describe(stored: StoredMap, stage: int, off_m: float | None) -> list[str]:
    number, inliers = int(stored.stage[stage]), stored.stage_believed[stage]
    title = "## Laid out along the compass headings" if number == 0 else f"## After round {number}"
    error = "" if off_m is None else f" RMS error {100 * off_m:.1f} cm."
    words = [title, f"{int(inliers.sum())} of {len(inliers)} loop closures are inliers.{error}"]
    if stage == len(stored.stage) - 1:
        expected = 100 * float(np.sqrt(np.mean(stored.expected[stored.known] ** 2)))
        share = 100 * stored.undecided.mean()
        words.append(f"The map itself expects an RMS error of {expected:.2f} cm; {share:.1f} % of it is undecided.")
    return words


def log_training(stream: rr.RecordingStream, name: str, history: History, span: Span, place: np.ndarray | None) -> None:
    """Log a finished training: its loss, and its snapshots, the last also at the start of the drive.

    True places of all observations are (N, 2) [m]; without, the snapshots stay in a frame of their own.
    """
    step, snapshots = history["snapshot_step"], history["snapshot"]
    last = max(int(history["step"][-1]), int(step[-1]), 1)
    log_loss(stream, name, history, step_rows(history["step"], last, span))
    for some, at in ((snapshots, [rr.TimeColumn(STEP, sequence=step)]), (snapshots[-1:], start_row(span))):
        if place is None:
            log_points(stream, f"world/training/{name}", snapshots[-1], some, at)
        else:
            log_snapshots(stream, name, place[history["snapshot_index"]], some, at)


def log_loss(stream: rr.RecordingStream, name: str, history: History, at: Rows, first: int = 0) -> None:
    """Log the decimal logarithm of a training's losses from ``first`` on, and its running median."""
    loss, colour = np.log10(np.maximum(np.asarray(history["loss"], float), 1e-9)), plots.colour_on_dark(name)
    send_series(stream, f"training/{name}/loss", at, loss[first:], "loss", (*colour, 90))
    send_series(stream, f"training/{name}/smooth", at, plots.smooth(loss, first), "median", colour)


def log_snapshots(stream: rr.RecordingStream, name: str, place: np.ndarray, snapshots: np.ndarray, at: Rows) -> None:
    """Log how the map (k, n, 2) [m] unfolds, and as arrows what is wrong with it, by the true places (n, 2) [m].

    Each snapshot is aligned to the true places by translation and rotation. Only those of DeepGPS may be mirrored:
    distances leave a mirror ambiguity, which turns resolve only after the training.
    """
    kind = "E2" if name.startswith("deepgps") else "SE2"
    aligned = np.stack([fit_alignment(points, place, kind).apply(points) for points in snapshots.astype(float)])
    log_points(stream, f"world/training/{name}", place, aligned, at)
    vectors = (aligned - place).reshape(-1, 2)
    origins, lengths = lift(np.tile(place, (len(aligned), 1)), LAYER_M), [len(place)] * len(aligned)
    colours = plots.colours_of(np.linalg.norm(vectors, axis=1))
    path, arrows = f"world/training_error/{name}", {"origins": origins, "vectors": lift(vectors, 0.0)}
    send_rows(stream, path, rr.Arrows3D, at, {**arrows, "colors": colours}, {"radii": 0.008}, lengths)
    dots, style = {"positions": origins, "colors": colours}, {"radii": 0.018, "point_shading": "Flat"}
    send_rows(stream, f"{path}/places", rr.Points3D, at, dots, style, lengths)


def log_points(
    stream: rr.RecordingStream, path: str, place: np.ndarray, snapshots: Sequence[np.ndarray] | np.ndarray, at: Rows
) -> None:
    """Log each snapshot's points (n, 2) [m], in the colours of the places (n, 2)."""
    colours = np.tile(colours_of_places(place), (len(snapshots), 1))
    points = {"positions": lift(np.concatenate(list(snapshots)), LAYER_M), "colors": colours}
    send_rows(stream, path, rr.Points3D, at, points, {"radii": 0.025}, [len(place)] * len(snapshots))
