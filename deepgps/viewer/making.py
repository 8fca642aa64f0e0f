"""The initial map by compass in the making: its path, turns and loop closures at each stage, and its errors at the end.

Every stage is aligned with the last, and that with the true places; without truth, the map is in its own frame.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from deepgps.config.methods import folder_of
from deepgps.data.segments import find_starts
from deepgps.evaluation.map_errors import read_known_map
from deepgps.initial_map.stored_map import StoredMap
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.stream import making_rows, put, put_text
from sim.alignment import Alignment, fit_alignment
from sim.recording.format import Recording

MAP_ENTITY, TEXT_ENTITY = "world/making", "making"
PATH_COLOUR, WARNING_COLOUR, TURN_COLOUR = (90, 160, 255), (255, 150, 40), (255, 230, 120)
INLIER_COLOUR, OUTLIER_COLOUR, OPEN_COLOUR = (63, 208, 165), (232, 37, 79), (120, 130, 150)
ARC_M, ARC_POINTS = 0.06, 12
MAX_ELLIPSES, ELLIPSE_POINTS, SIGMAS, MIN_HALF_AXIS_M = 100, 24, 2.0, 0.06
"""Most ellipses, points of each, standard deviations, and the half axis up to which the middle one is enlarged [m]."""
LEGEND = (
    "Blue: path; orange: parts that stay undecided. Yellow arcs: turns, by the two images before and after; point at "
    "one for its angle. Green: loop closures that are inliers; red: refused; grey: not judged yet. Each stage is "
    "aligned with the last."
)


def find_map(run: Path, methods: Iterable[str]) -> tuple[str | None, StoredMap | None]:
    """The first of the methods that kept its initial map, and the map; None twice if there is none."""
    for method in methods:
        if (stored := read_known_map(folder_of(run, method))) is not None:
            return method, stored
    return None, None


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
        at = making_rows(stage, last)
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
    outlines = outline_ellipses(stored.covariance[some], SIGMAS * larger) @ world.rotation.T
    strips = [lift(one, 4 * LAYER_M) for one in outlines + world.apply(stored.places[some])[:, None]]
    colours = np.where(stored.undecided[some, None], WARNING_COLOUR, (255, 255, 255)).astype(np.uint8)
    said = [f"± {100 * one:.2f} cm (RMS)" for one in stored.expected[some]]
    return "ellipses", strips, 0.004, colours, {"expected": said}


def enlarge(stored: StoredMap) -> float:
    """How many times larger ellipses are drawn so that the middle one can be seen: 1, 2, 5, 10, 20, ..."""
    middle = SIGMAS * float(np.median(stored.expected[stored.known])) / np.sqrt(2.0)
    steps = np.outer(10.0 ** np.arange(4), [1.0, 2.0, 5.0]).ravel()
    return float(steps[max(np.searchsorted(steps, MIN_HALF_AXIS_M / max(middle, 1e-9), "right") - 1, 0)])


def outline_ellipses(covariance: np.ndarray, sigmas: float) -> np.ndarray:
    """Outlines (n, ELLIPSE_POINTS, 2) [m] of so many standard deviations of covariances (n, 2, 2) [m^2]."""
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    value, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(value.clip(0.0))[:, None, :]
    return sigmas * circle @ root.transpose(0, 2, 1)


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
