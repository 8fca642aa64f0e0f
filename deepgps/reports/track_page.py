"""The page of a tracked drive: a table of its errors, and a picture of the path and of the errors over time."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from rich.console import Console

from deepgps.config.methods import title_of
from deepgps.evaluation.track_run import POSE_SEPARATION, Reference, Tracked, measure_distances, take_in_world
from deepgps.reports.plots import PAPER, SCALE_M, add_scale, colours_of, count_by_decades, draw_room, to_png
from deepgps.reports.table import Column, fill, head, print_table, say
from deepgps.tracking.causes import describe_causes
from deepgps.tracking.track import PATHS, Track
from sim.files.atomic import write_bytes
from sim.recording.turns import NO_IMAGE


def write_fine(value: float) -> str:
    """A length [m] in centimetres, or a share in per cent, with two decimals."""
    return f"{100 * value:.2f}"


COLUMNS: tuple[Column, ...] = (
    ("RMS [cm]", "rms_m", write_fine),
    ("median [cm]", "median_m", write_fine),
    ("95 % [cm]", "p95_m", write_fine),
    ("max [cm]", "max_m", write_fine),
    ("ATE [cm]", "ate_m", write_fine),
    ("RPE [cm]", "rpe_m", write_fine),
    ("yaw [deg]", "yaw_rms_deg", "{:.2f}".format),
    ("accepted [%]", "accepted", write_fine),
)
COLOURS = {"single": "#9aa5b1", "causal": "#e07b00", "smoothed": "#0b62d6", "dead_reckoning": "#7a5c3e"}
"""Paths that are drawn."""


def print_track(tracked: Tracked, console: Console) -> None:
    """Print what was tracked, and the table of errors where the truth is known."""
    figures = tracked.figures
    accepted = figures["accepted"]
    say(
        console,
        f"{title_of(tracked.method)}: {figures['tracked']} of {figures['images']} images tracked; "
        f"{100 * accepted['causal']:.1f} % accepted while driving, {100 * accepted['smoothed']:.1f} % afterwards.\n",
    )
    if "causes" in figures:
        say(console, f"{describe_causes(figures['causes'])}\n")
    if "paths" not in figures:
        frame = "map's own frame" if tracked.alignment is None else "world's frame"
        say(console, f"The truth is not known, so there are no errors. --tum writes poses in the {frame}.")
        return
    rows = [[title, *fill(COLUMNS, figures["paths"][name])] for name, title in PATHS.items()]
    print_table(console, ("path", *head(COLUMNS)), rows)
    say(
        console,
        f"\nErrors on images of the drive; ATE after an alignment of its own, RPE over {POSE_SEPARATION} images.",
    )


def draw_track(tracked: Tracked) -> Path | None:
    """Draw the tracked path and its errors beside the run's track; None where the truth is not known."""
    if tracked.reference is None:
        return None
    path = tracked.path.with_suffix(".png")
    write_bytes(path, to_png(make_figure(tracked.track, tracked.reference, title_of(tracked.method))))
    return path


def make_figure(track: Track, reference: Reference, title: str) -> Figure:
    """The path while driving over the room, coloured by its error, and all errors over time."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    room, time = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    draw_room(room, reference.space, PAPER)
    _draw_path(room, track, reference)
    room.set_title(f"{title}, tracked while driving", fontsize=11)
    add_scale(figure, [room], label="error of the position [m]")
    _draw_errors(time, track, reference)
    return figure


def _draw_path(axes: Axes, track: Track, reference: Reference) -> None:
    seen = track.observation != NO_IMAGE
    place = take_in_world(track.paths["causal"], reference.alignment)[seen, :2]
    error = measure_distances(track.paths["causal"], reference.alignment, reference.pose)[seen]
    known = np.isfinite(error)
    place, error = place[known], error[known]
    lines = np.stack([place[:-1], place[1:]], axis=1)
    near = np.hypot(*(lines[:, 1] - lines[:, 0]).T) < 0.5  # a jump is not a way
    colours = colours_of(np.maximum(error[:-1], error[1:])[near], SCALE_M) / 255
    axes.add_collection(LineCollection(list(lines[near]), colors=colours, linewidths=1.4))
    axes.scatter(*place[:1].T, marker="o", s=40, facecolors="none", edgecolors="#161a22", label="first image")
    axes.legend(fontsize=8, loc="upper right")


def _draw_errors(axes: Axes, track: Track, reference: Reference) -> None:
    seen, since = track.observation != NO_IMAGE, track.time - np.nanmin(track.time)
    for name, colour in COLOURS.items():
        error = 100.0 * measure_distances(track.paths[name], reference.alignment, reference.pose)
        width = 0.7 if name == "single" else 1.2
        axes.plot(since[seen], error[seen], color=colour, lw=width, label=PATHS[name])
    lost = seen & ~track.paths["causal"].accepted
    axes.plot(since[lost], np.full(lost.sum(), 0.02), "|", color="#e8254f", label="causal, not accepted")
    axes.set(yscale="log", xlabel="time [s]", ylabel="error of the position [cm]", ylim=(0.015, None))
    count_by_decades(axes.yaxis)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
