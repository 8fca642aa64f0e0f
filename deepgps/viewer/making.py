"""The initial map by compass in the making: its path, turns and loop closures at each stage, and its errors at the end.

Every stage is aligned with the last, and that with the true places; without truth, the map is in its own frame.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.config.methods import folder_of
from deepgps.data.segments import find_starts
from deepgps.evaluation.map_errors import read_known_map
from deepgps.initial_map.stored_map import StoredMap
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.stream import Rows, making_rows, put, put_text
from sim.alignment import Alignment, fit_alignment
from sim.recording.format import Recording

MAKING, TEXT = "world/making", "making"
PATH, WARNING, TURN = (90, 160, 255), (255, 150, 40), (255, 230, 120)
BELIEVED, REFUSED, OPEN = (63, 208, 165), (232, 37, 79), (120, 130, 150)
ARC_M, ARC_POINTS = 0.06, 12
ELLIPSES, ELLIPSE_POINTS, SIGMAS, SEEN_M = 100, 24, 2.0, 0.06
"""Most ellipses, points of each, standard deviations, and the half axis up to which the middle one is enlarged [m]."""
LEGEND = (
    "Blue: path; orange: parts that stay undecided. Yellow arcs: turns, by the two images before and after; point at "
    "one for its angle. Green: loop closures that are believed; red: refused; grey: not judged yet. Each stage is "
    "aligned with the last."
)


def find_map(run: Path, methods: Iterable[str]) -> tuple[str | None, StoredMap | None]:
    """The first of the methods that kept its initial map, and the map; None twice if there is none."""
    for method in methods:
        if (stored := read_known_map(folder_of(run, method))) is not None:
            return method, stored
    return None, None


def log_making(stream: rr.RecordingStream, stored: StoredMap, recording: Recording, place: np.ndarray | None) -> None:
    """Log every stage of a map's making.

    Args:
        stream: Stream to log to.
        stored: The map.
        recording: The recording that it is of.
        place: True positions of the observations (N, 2) [m]; None: there is no truth.
    """
    known = stored.known
    upon = stored.places if place is None else place
    world = fit_alignment(stored.places[known], upon[known], "SE2")
    final = world.apply(stored.places)
    segment = find_starts(recording.reading[:, 0])
    rows = np.split(recording.reading[:, 1], np.flatnonzero(np.diff(segment)) + 1)
    last = len(stored.stage) - 1
    for stage in range(last + 1):
        at = making_rows(stage, last)
        own = fit_alignment(stored.stage_places[stage][known].astype(float), final[known], "SE2")
        places = own.apply(stored.stage_places[stage].astype(float))
        _log_path(stream, places, rows, stored.undecided, at)
        _log_turns(stream, stored, places, own.turn(stored.stage_heading[stage].astype(float)), at)
        _log_closures(stream, stored, places, stage, at)
        off_m = None if place is None else float(np.sqrt(((places - place)[known] ** 2).sum(axis=1).mean()))
        words = _describe(stored, stage, off_m)
        if stage == last:
            larger = _log_ellipses(stream, stored, world, at)
            size = f"drawn {larger:g} times as large" if larger > 1.0 else "at their true size"
            words += [f"Ellipses: {SIGMAS:g} standard deviations, {size}."]
        put_text(stream, TEXT, "\n\n".join([*words, LEGEND]), at)


def _log_path(
    stream: rr.RecordingStream, places: np.ndarray, rows: list[np.ndarray], undecided: np.ndarray, at: Rows
) -> None:
    """Log the segments, those that end undecided in a colour of their own."""
    strips = {"path": [], "undecided": []}
    for row in rows:
        points = row[np.isfinite(places[row, 0])]
        if len(points) > 1:
            strips["undecided" if undecided[points].mean() > 0.5 else "path"].append(lift(places[points], LAYER_M))
    for name, colour in (("path", PATH), ("undecided", WARNING)):
        put(stream, f"{MAKING}/{name}", rr.LineStrips3D(strips[name], radii=0.004, colors=[colour]), at)


def _log_turns(
    stream: rr.RecordingStream, stored: StoredMap, places: np.ndarray, heading: np.ndarray, at: Rows
) -> None:
    """Log an arc at each turn, from the heading before to the heading after, with a stroke along the latter."""
    before = stored.turn[:, 0]
    shown = np.isfinite(places[before, 0])
    before, angle, std = before[shown], stored.turn_angle[shown], np.degrees(stored.turn_std[shown])
    sweep = heading[before, None] + angle[:, None] * np.linspace(0.0, 1.0, ARC_POINTS)
    arcs = places[before, None] + ARC_M * np.stack([np.cos(sweep), np.sin(sweep)], axis=2)
    strips = np.concatenate([arcs, places[before, None]], axis=1)
    said = [f"{one:+.1f}° ± {err:.2f}°" for one, err in zip(np.degrees(angle), std, strict=True)]
    lines = rr.LineStrips3D([lift(strip, 2 * LAYER_M) for strip in strips], radii=0.003, colors=[TURN])
    put(stream, f"{MAKING}/turns", lines, at, {"turned": said})


def _log_closures(stream: rr.RecordingStream, stored: StoredMap, places: np.ndarray, stage: int, at: Rows) -> None:
    """Log a line between the two ends of each loop closure; before the first round, none is judged."""
    ends = places[stored.closure]
    shown, believed = np.isfinite(ends).all(axis=(1, 2)), stored.stage_believed[stage]
    for name, chosen, colour in (
        ("refused", shown & ~believed, OPEN if stored.stage[stage] == 0 else REFUSED),
        ("believed", shown & believed, BELIEVED),
    ):
        strips = [lift(pair, 3 * LAYER_M) for pair in ends[chosen]]
        apart = np.linalg.norm(ends[chosen, 0] - ends[chosen, 1], axis=1)
        turned = np.degrees(stored.closure_turn[chosen])
        said = [
            f"images {one} and {other}, {100 * away:.0f} cm apart" + ("" if np.isnan(angle) else f", {angle:+.1f}°")
            for (one, other), away, angle in zip(stored.closure[chosen], apart, turned, strict=True)
        ]
        lines = rr.LineStrips3D(strips, radii=0.003, colors=[colour])
        put(stream, f"{MAKING}/{name}", lines, at, {"alike": said})


def _log_ellipses(stream: rr.RecordingStream, stored: StoredMap, world: Alignment, at: Rows) -> float:
    """Log ellipses of the positions' errors at some observations, and return how many times larger they are drawn."""
    known = np.flatnonzero(stored.known)
    some = known[np.linspace(0, len(known) - 1, min(ELLIPSES, len(known))).astype(int)]
    larger = enlarge(stored)
    outlines = outline_ellipses(stored.covariance[some], SIGMAS * larger) @ world.rotation.T
    strips = [lift(one, 4 * LAYER_M) for one in outlines + world.apply(stored.places[some])[:, None]]
    colours = np.where(stored.undecided[some, None], WARNING, (255, 255, 255)).astype(np.uint8)
    said = [f"± {100 * one:.2f} cm (RMS)" for one in stored.expected[some]]
    lines = rr.LineStrips3D(strips, radii=0.004, colors=colours)
    put(stream, f"{MAKING}/ellipses", lines, at, {"expected": said})
    return larger


def enlarge(stored: StoredMap) -> float:
    """How many times larger ellipses are drawn so that the middle one can be seen: 1, 2, 5, 10, 20, ..."""
    middle = SIGMAS * float(np.median(stored.expected[stored.known])) / np.sqrt(2.0)
    steps = np.outer(10.0 ** np.arange(4), [1.0, 2.0, 5.0]).ravel()
    return float(steps[max(np.searchsorted(steps, SEEN_M / max(middle, 1e-9), "right") - 1, 0)])


def outline_ellipses(covariance: np.ndarray, sigmas: float) -> np.ndarray:
    """Outlines (n, ELLIPSE_POINTS, 2) [m] of so many standard deviations of covariances (n, 2, 2) [m^2]."""
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    value, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(value.clip(0.0))[:, None, :]
    return sigmas * circle @ root.transpose(0, 2, 1)


def _describe(stored: StoredMap, stage: int, off_m: float | None) -> list[str]:
    number, believed = int(stored.stage[stage]), stored.stage_believed[stage]
    title = "## Laid out along the compass headings" if number == 0 else f"## After round {number}"
    error = "" if off_m is None else f" RMS error {100 * off_m:.1f} cm."
    words = [title, f"{int(believed.sum())} of {len(believed)} loop closures are believed.{error}"]
    if stage == len(stored.stage) - 1:
        expected = 100 * float(np.sqrt(np.mean(stored.expected[stored.known] ** 2)))
        share = 100 * stored.undecided.mean()
        words.append(f"The map itself expects an RMS error of {expected:.2f} cm; {share:.1f} % of it is undecided.")
    return words
