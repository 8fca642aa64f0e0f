"""Draw the pictures of the page "How a distance becomes a map" from three runs, by the maps that they kept.

``.venv/bin/deepgps run quick --methods deepgps_compass --drive.samples 4000 --out runs/map``, then
``.venv/bin/deepgps run labyrinth --methods deepgps_compass --drive.samples 3000 --encoder.step-noise 0.3
--encoder.slip-per-m 0.3 --learn.features.principal 256 --learn.train.steps 200 --out runs/repeats``, then
``.venv/bin/deepgps run living_room --methods deepgps --drive.samples 1000 --out runs/few``, then
``.venv/bin/python -m docs.map_pictures runs/map runs/repeats runs/few``.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from deepgps.data.segments import fill_stretches
from deepgps.initial_map.stored_map import StoredMap, read_map
from deepgps.positioner.stored_positioner import load_positioner, read_training
from deepgps.reports.plots import PAPER, draw_room, to_png
from deepgps.viewer.making import SIGMAS, enlarge
from docs.pictures import PICTURES, reduce
from sim.alignment import fit_alignment, fit_robust_alignment
from sim.files.atomic import write_bytes
from sim.recording.format import Truth, open_recording, open_truth

PATH_COLOUR, UNDECIDED_COLOUR, INLIER_COLOUR, OUTLIER_COLOUR = "#5b7fb5", "#ff8c1a", "#1fa37c", "#e8254f"
FIRST_READINGS = 200
"""Readings, from the start, in the picture of the turns."""
MAX_ELLIPSES = 120


class Drawn:
    """A map with what it is drawn over.

    Args:
        run: The run's folder.
    """

    def __init__(self, run: Path) -> None:
        found = read_map(run / "deepgps_compass")
        assert found is not None, f"{run} has no map by compass"
        self.map: StoredMap = found
        self.truth: Truth = open_truth(run / "recording")
        self.reading = open_recording(run / "recording").reading
        self.known = found.known

    def place(self, stage: int) -> tuple[np.ndarray, float]:
        """Positions (N, 2) [m] at a stage in the world's frame, and their RMS error [m]."""
        points, true = self.map.stage_places[stage].astype(float), self.truth.pose[:, :2]
        points = fit_alignment(points[self.known], true[self.known], "SE2").apply(points)
        return points, float(np.sqrt(((points - true)[self.known] ** 2).sum(axis=1).mean()))

    def trace(self, axes: Axes, points: np.ndarray, readings: int | None = None) -> None:
        """Draw the path, with undecided parts in orange."""
        draw_room(axes, self.truth.free_space, PAPER)
        reading = self.reading[:readings]
        same = np.diff(reading[:, 0]) == 0
        ends = np.stack([reading[:-1, 1], reading[1:, 1]], axis=1)[same]
        pairs, undecided = points[ends], self.map.undecided[ends].all(axis=1)
        colours = np.where(undecided, UNDECIDED_COLOUR, PATH_COLOUR).tolist()
        axes.add_collection(LineCollection(list(pairs), colors=colours, linewidths=0.7))
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])

    def join(self, axes: Axes, points: np.ndarray, inliers: np.ndarray, colour: str) -> None:
        """Draw loop closures."""
        pairs = points[self.map.closure[inliers]]
        axes.add_collection(LineCollection(list(pairs), colors=colour, linewidths=0.6, alpha=0.6))


def draw_turns(drawn: Drawn) -> Figure:
    """The beginning of the drive with the angles that the compass measured, and the whole drive laid out."""
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    points, rms = drawn.place(0)
    drawn.trace(left, points, FIRST_READINGS)
    seen = set(drawn.reading[:FIRST_READINGS, 1].tolist())
    for before, angle in zip(drawn.map.turn[:, 0], drawn.map.turn_angle, strict=True):
        if before in seen and np.isfinite(points[before, 0]):
            left.plot(*points[before], "o", color=OUTLIER_COLOUR, ms=3)
            left.annotate(f"{np.degrees(angle):+.1f}°", points[before], (3, 3), textcoords="offset points", fontsize=7)
    left.set_title("1. turns by compass, lengths by encoder: the first segments", loc="left", fontsize=11)
    drawn.trace(right, points)
    right.set_title(f"2. the whole drive, laid end to end: {100 * rms:.1f} cm RMS", loc="left", fontsize=11)
    return figure


def draw_rounds(drawn: Drawn) -> Figure:
    """The loop closures that are inliers when about a third is, and at the last round."""
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    early = int(np.abs(drawn.map.stage_believed[:-1].mean(axis=1) - 1 / 3).argmin())
    for axes, stage in zip(figure.subplots(1, 2), (early, -1), strict=True):
        points, rms = drawn.place(stage)
        inliers = drawn.map.stage_believed[stage]
        drawn.trace(axes, points)
        drawn.join(axes, points, inliers, INLIER_COLOUR)
        title = f"after round {drawn.map.stage[stage]}: {inliers.sum():,} of {len(inliers):,} inliers, "
        axes.set_title(f"{title}{100 * rms:.1f} cm RMS", loc="left", fontsize=11)
    return figure


def draw_ellipses(drawn: Drawn) -> Figure:
    """The final map with its own covariance."""
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    axes = figure.subplots()
    points, rms = drawn.place(-1)
    drawn.trace(axes, points)
    known, larger = np.flatnonzero(drawn.known), enlarge(drawn.map)
    some = known[np.linspace(0, len(known) - 1, MAX_ELLIPSES).astype(int)]
    true = drawn.truth.pose[known, :2]
    rotation = fit_alignment(drawn.map.places[known], true, "SE2").rotation
    value, vector = np.linalg.eigh(rotation @ drawn.map.covariance[some] @ rotation.T)
    size = 2.0 * SIGMAS * larger * np.sqrt(value)
    angle = np.degrees(np.arctan2(vector[:, 1, 0], vector[:, 0, 0]))
    axes.add_collection(
        EllipseCollection(
            size[:, 0],
            size[:, 1],
            angle,
            units="xy",
            offsets=points[some],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors="#222222",
            linewidths=0.8,
        )
    )
    expected = np.sqrt(np.mean(drawn.map.expected[known] ** 2))
    title = f"expected {100 * expected:.2f} cm RMS, true {100 * rms:.2f} cm; ellipses: {SIGMAS:g} standard deviations"
    axes.set_title(f"{title}, {larger:g} times as large", loc="left", fontsize=11)
    return figure


def draw_undecided(drawn: Drawn) -> Figure:
    """A world that repeats: the loop closures that were refused, and the parts of the path that stay undecided."""
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    grid = figure.subplots(1, 2)
    points, rms = drawn.place(-1)
    inliers = drawn.map.stage_believed[-1]
    for axes, chosen, colour, word in (
        (grid[0], inliers, INLIER_COLOUR, "inliers"),
        (grid[1], ~inliers, OUTLIER_COLOUR, "refused"),
    ):
        drawn.trace(axes, points)
        drawn.join(axes, points, chosen, colour)
        axes.set_title(f"{chosen.sum():,} loop closures {word}", loc="left", fontsize=11)
    share = 100 * drawn.map.undecided.mean()
    figure.suptitle(f"{share:.0f} % undecided (orange); RMS error {100 * rms:.0f} cm", fontsize=11)
    return figure


def draw_mirrored(run: Path) -> Figure:
    """A map from distances alone, aligned, beside where its images were taken; the part in doubt in orange."""
    folder, recording, truth = run / "deepgps", open_recording(run / "recording"), open_truth(run / "recording")
    places = load_positioner(folder)(recording.observation)
    places = fit_robust_alignment(places, truth.pose[:, :2], "E2").apply(places)
    doubtful = fill_stretches(read_training(folder)["map"]["parts"], len(places))
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    for axes, points, title in zip(
        figure.subplots(1, 2, sharex=True, sharey=True),
        (places, truth.pose[:, :2]),
        ("the map from distances alone", "where the images were taken"),
        strict=True,
    ):
        draw_room(axes, truth.free_space, PAPER)
        for some, colour in ((~doubtful, PATH_COLOUR), (doubtful, UNDECIDED_COLOUR)):
            axes.scatter(*points[some].T, s=7, color=colour, linewidths=0)
        axes.set_title(title, loc="left", fontsize=11)
    return figure


def draw_all(run: Path, repeats: Path, few: Path) -> None:
    """Draw every picture of the page."""
    drawn = Drawn(run)
    figures = {
        "map_turns": draw_turns(drawn),
        "map_rounds": draw_rounds(drawn),
        "map_ellipses": draw_ellipses(drawn),
        "map_undecided": draw_undecided(Drawn(repeats)),
        "map_mirrored": draw_mirrored(few),
    }
    for name, figure in figures.items():
        write_bytes(PICTURES / f"{name}.png", reduce(to_png(figure)))


if __name__ == "__main__":
    draw_all(*map(Path, sys.argv[1:]))
