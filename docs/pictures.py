"""Draw the pictures of the page "Concepts" from a run of the scenario ``quick``.

``.venv/bin/deepgps run quick --out runs/quick``, then ``.venv/bin/python -m docs.pictures runs/quick``.
"""

import sys
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from deepgps.config.learning import LearnSettings
from deepgps.config.methods import colour_of
from deepgps.config.scenario import Scenario
from deepgps.evaluation.error_field import find_worst, read_all_headings
from deepgps.evaluation.segment_errors import reckon_path
from deepgps.initial_map.distances.dense import NEIGHBOURS, find_affine_maps, find_modes
from deepgps.initial_map.distances.isomap import find_loop_closures, map_by_paths
from deepgps.initial_map.distances.pose_graph import build_pose_graph
from deepgps.learning.trainer import make_generator, use_threads
from deepgps.learning.training_data import prepare
from deepgps.methods.deepgps import make_initial_map
from deepgps.methods.fit import fit_method
from deepgps.reports.plots import PAPER, add_scale, count_by_decades, draw_field, draw_room, to_png
from deepgps.reports.run_figures import read_histories
from deepgps.runs.run_folder import open_run
from deepgps.viewer.scene import colours_of_places
from sim.alignment import fit_alignment
from sim.files.atomic import write_bytes
from sim.files.checksums import read_arrays
from sim.geometry import limits
from sim.recording.format import Recording, Truth, open_recording, open_truth
from sim.sensors.camera.gl import choose_backend

PICTURES = Path(__file__).parent / "pictures"
ROUND_PX = 480
TURN_SECTORS = 32
"""Sectors that the robot turns left by in the picture of the camera: a quarter turn."""
SEGMENTS = 150
"""Segments, from the start, in the picture of the path."""


def draw_all(run: Path) -> None:
    """Draw every picture from a run of ``quick``."""
    scenario, recording, truth = open_run(run), open_recording(run / "recording"), open_truth(run / "recording")
    figures = {
        "camera": draw_camera(scenario, truth),
        "segments": draw_segments(recording, truth),
        "straightness": draw_straightness(run, scenario, recording, truth),
        "map": draw_maps(run, scenario, recording, truth),
        "fold": draw_fold(run, scenario, recording, truth),
        "error_field": draw_errors(run, truth),
    }
    for name, figure in figures.items():
        write_bytes(PICTURES / f"{name}.png", reduce(to_png(figure)))


def reduce(png: bytes) -> bytes:
    """The picture in 256 colours, a third of its size."""
    buffer = BytesIO()
    Image.open(BytesIO(png)).convert("RGB").quantize(256).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def draw_camera(scenario: Scenario, truth: Truth) -> Figure:
    """The round image, the polar image, and the polar image after a quarter turn, all rendered."""
    choose_backend()  # before mujoco is imported
    from sim.robot.world import RoomWorld
    from sim.sensors.camera.fisheye import Fisheye

    world = RoomWorld(scenario.sim)
    middle = truth.pose[:, :2].mean(axis=0)
    pose = truth.pose[np.linalg.norm(truth.pose[:, :2] - middle, axis=1).argmin()]
    turned = pose + [0.0, 0.0, 2 * np.pi * TURN_SECTORS / scenario.camera.sectors]
    with Fisheye(world.model, scenario.camera) as fisheye:
        world.place(pose)
        image, before = fisheye.round(world.data, ROUND_PX), fisheye.polar(world.data)
        world.place(turned)
        after = fisheye.polar(world.data)
    figure = Figure(figsize=(11, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.75])
    left.imshow(image)
    left.set_title("the camera's image", loc="left", fontsize=12)
    left.text(0.5, 0.98, "ahead", transform=left.transAxes, ha="center", va="top", fontsize=10, color="#ffffff")
    titles = ("polar image: zenith at the top, once around the robot", "the same after a quarter turn to the left")
    shifts = (0, -TURN_SECTORS % scenario.camera.sectors)
    for picture, title, shift, bottom in zip((before, after), titles, shifts, (0.53, 0.0), strict=True):
        axes = right.inset_axes((0.0, bottom, 1.0, 0.42))
        axes.imshow(picture, aspect="auto", interpolation="nearest")
        axes.set_title(title, loc="left", fontsize=12)
        axes.axvline(shift, color="#ffffff", lw=2, ls=":")
        axes.text(shift + 1.5, 29, "ahead before the turn", color="#ffffff", fontsize=10, va="center")
        axes.set_axis_off()
    for axes in (left, right):
        axes.set_axis_off()
    return figure


def draw_segments(recording: Recording, truth: Truth) -> Figure:
    """The true path and the dead-reckoned one, with one segment and its readings marked."""
    some = recording.reading[:, 0] < SEGMENTS
    segment = recording.reading[some, 0]
    paths = truth.pose[recording.reading[some, 1], :2], reckon_path(recording, truth.pose)[some]
    marked = np.flatnonzero(segment == np.bincount(segment).argmax())
    length = np.linalg.norm(paths[0][marked[-1]] - paths[0][marked[0]])
    titles = (
        f"where the robot drove; one segment: {len(marked)} readings, {length:.2f} m",
        "the same path, dead-reckoned from the wheels",
    )
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    grid = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, path, title in zip(grid, paths, titles, strict=True):
        draw_room(axes, truth.free_space, PAPER)
        axes.plot(*path.T, color="#5b6b85", lw=0.6)
        axes.plot(*path[marked].T, "o-", color="#e8254f", ms=3, lw=1.5)
        axes.set_title(title, loc="left", fontsize=11)
        axes.label_outer()
    corners = np.concatenate([np.stack(limits(truth.free_space)), *paths])
    low, high = corners.min(axis=0) - 0.1, corners.max(axis=0) + 0.1
    grid[0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return figure


def draw_straightness(run: Path, scenario: Scenario, recording: Recording, truth: Truth) -> Figure:
    """The two slowest modes, the rough map that they become, and that of shortest paths, with their errors."""
    data = prepare(recording, scenario.learn, scenario.seed, run)
    segments, count = data.segments, len(data.features)
    closures = find_loop_closures(data.features, segments, NEIGHBOURS)
    with use_threads(1):
        graph = build_pose_graph(segments, closures[0], np.ones(count, bool))
        middle, slope, _ = find_modes(graph, np.ones(len(graph.a)))
        rough = next(find_affine_maps(count, segments, closures[0]))
        paths = map_by_paths(count, segments, closures[0], make_generator(scenario.seed, "start", 0))
    modes = np.full((count, 2), np.nan)
    modes[graph.observation] = middle[graph.bar, :2] + graph.along[:, None] * slope[graph.bar, :2]
    figure = Figure(figsize=(11, 2.9), layout="constrained")
    axes = figure.subplots(1, 3)
    maps = {"slopes as long as driven": rough, "by shortest paths instead": paths}
    scatter_alone(axes[0], modes / np.nanstd(modes, axis=0), truth.pose[:, :2])
    axes[0].set_title("the two slowest modes", loc="left", fontsize=12)
    for some, (title, points) in zip(axes[1:], maps.items(), strict=True):
        known = np.isfinite(points).all(axis=1)
        laid = fit_alignment(points[known], truth.pose[known, :2], "E2").apply(points)
        error = 100 * np.sqrt(np.nanmean(((laid - truth.pose[:, :2]) ** 2).sum(axis=1)))
        scatter_alone(some, laid, truth.pose[:, :2])
        some.set_title(f"{title}: RMS {error:.1f} cm", loc="left", fontsize=12)
    return figure


def draw_maps(run: Path, scenario: Scenario, recording: Recording, truth: Truth) -> Figure:
    """The initial map, and the network's map at three steps of the training."""
    history = read_histories(run)["deepgps"]
    data = prepare(recording, scenario.learn, scenario.seed, run)
    with use_threads(1):
        initial = make_initial_map(data.features, data.segments, "paths", scenario.seed, 0)[0].numpy()
    mapped = np.isfinite(initial).all(axis=1)
    place = truth.pose[history["snapshot_index"], :2]
    maps = [("1. initial map, without a network", initial[mapped], truth.pose[mapped, :2])]
    steps = ((0, "2. the network before training"), (3, "3. imitating it"), (-1, "4. refined by distances"))
    for number, words in steps:
        step = int(history["snapshot_step"][number])
        maps.append((f"{words}, step {step}", history["snapshot"][number].astype(float), place))
    figure = Figure(figsize=(11, 7.0), layout="constrained")
    for axes, (title, points, true) in zip(figure.subplots(2, 2, sharex=True, sharey=True).flat, maps, strict=True):
        scatter(axes, truth, fit_alignment(points, true, "E2").apply(points), true)
        axes.set_title(title, loc="left", fontsize=12)
        axes.label_outer()
    return figure


def draw_fold(run: Path, scenario: Scenario, recording: Recording, truth: Truth) -> Figure:
    """The run's map, its mirror image, and a map that a random start has folded."""
    learn = LearnSettings.model_validate({**scenario.learn.model_dump(), "start": "random"})
    with TemporaryDirectory() as folder:
        fit_method("deepgps", recording, learn, scenario.seed, Path(folder) / "deepgps")
        folded = read_arrays(Path(folder) / "deepgps" / "history.npz")
    history = read_histories(run)["deepgps"]
    place = truth.pose[history["snapshot_index"], :2]
    right = fit_alignment(history["snapshot"][-1], place, "E2").apply(history["snapshot"][-1].astype(float))
    wrong = fit_alignment(folded["snapshot"][-1], place, "E2").apply(folded["snapshot"][-1].astype(float))
    maps = {"right": right, "mirrored: as good": right * [-1, 1], "folded: a failure (random start)": wrong}
    figure = Figure(figsize=(11, 2.9), layout="constrained")
    for axes, (title, points) in zip(figure.subplots(1, 3, sharex=True, sharey=True), maps.items(), strict=True):
        scatter_alone(axes, points, place)
        axes.set_title(title, loc="left", fontsize=12)
    return figure


def draw_errors(run: Path, truth: Truth) -> Figure:
    """The error field, and the distribution of its errors with RMS, median and maximum."""
    field = read_all_headings(run)["deepgps"]
    figure = Figure(figsize=(11, 4.1), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.9, 1])
    draw_field(left, truth.free_space, field)
    left.set_title("error field: DeepGPS, scenario quick", loc="left", fontsize=12)
    add_scale(figure, [left])
    error = np.sort(100 * find_worst(field).error)
    right.plot(error, 100 * np.arange(1, len(error) + 1) / len(error), color=colour_of("deepgps"), lw=2)
    marks = {"median": np.median(error), "RMS": np.sqrt(np.mean(error**2)), "max": error[-1]}
    for name, value in marks.items():
        right.axvline(value, color="#8a94a6", lw=1, ls="--")
        side = "right" if name == "max" else "left"
        right.text(value, 4, f" {name} {value:.1f} cm ", rotation=90, va="bottom", ha=side, fontsize=9.5)
    right.set(
        xscale="log", xlabel="error of the worst heading [cm]", ylabel="test positions with less [%]", ylim=(0, 101)
    )
    count_by_decades(right.xaxis)
    right.set_title("the same errors, sorted", loc="left", fontsize=12)
    right.grid(alpha=0.25)
    return figure


def scatter(axes: Axes, truth: Truth, points: np.ndarray, place: np.ndarray) -> None:
    """Draw a map's points (n, 2) [m] over the floor, in the colours of their true places (n, 2) [m]."""
    draw_room(axes, truth.free_space, PAPER)
    axes.scatter(*points.T, s=5, c=colours_of_places(place) / 255, linewidths=0)


def scatter_alone(axes: Axes, points: np.ndarray, place: np.ndarray) -> None:
    """Draw a map's points (n, 2) in the colours of their true places (n, 2) [m], without the floor."""
    axes.scatter(*points.T, s=4, c=colours_of_places(place) / 255, linewidths=0)
    axes.set(aspect="equal", xticks=[], yticks=[])


if __name__ == "__main__":
    torch.set_num_threads(1)
    draw_all(Path(sys.argv[1]))
