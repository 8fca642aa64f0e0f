"""The report of what a method knows of itself: what is refused of each fault, what is named, what the radii hold."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from matplotlib.patches import Rectangle

from deepgps.config.methods import title_of
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, share_of, write
from deepgps.studies.reports.knowing_drives import JudgedDrive, read_drives
from deepgps.studies.table import Row, split_by
from deepgps.tracking.rules import TITLES

VALUES, ROOM = "learn.features.values", "room.kind"
RADII = {"grid_68": "68 %, grid", "grid_95": "95 %, grid", "use_68": "68 %, use", "use_95": "95 %, use"}
LARGE = {"large_refused": "errors > 10 cm refused"}
NOTE = (
    "All of the drive in use. Refused: share of its images; then the share of the images with each cause, also of "
    "accepted ones where the light has changed or images are frozen. Named: the causes of the drive, that of most "
    "images first; a lean is one of all images. Radii: share of the accepted images whose true position is within. "
    "Black and white images, a covered lens, frozen images and the drive in another room are derived from the run "
    "without a change; for 'a part not driven' its method is trained again without the segments that enter the last "
    "30 % of its map."
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table for each method, kind of features and room: what is refused and named of each fault."""
    blocks = []
    for title, some in split_trainings(rows).items():
        drives = read_drives(some, varied)
        causes = [name for name in TITLES if any(name in drive.shares for drive in drives)]
        headings = ["fault", "refused", *(TITLES[name] for name in causes), "named", *RADII.values(), *LARGE.values()]
        blocks += [f"## {title}", tabulate(headings, [_write(drive, causes) for drive in drives])]
    return [*blocks, NOTE]


def _write(drive: JudgedDrive, causes: Sequence[str]) -> list[str]:
    shares = [write(drive.shares.get(name, 0.0), "%") for name in causes]
    named = ", ".join(TITLES[name] for name in drive.causes["named"]) or "-"
    figures = [write(drive.figures.get(name), "%") for name in (*RADII, *LARGE)]
    return [drive.fault, write(1.0 - drive.accepted, "%"), *shares, named, *figures]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """How often the cause is named and what is refused, with features of ranks."""
    some = [row for row in rows if row.get(VALUES, "ranks") == "ranks"]
    drives = read_drives(some, [name for name in rows[0] if name.startswith("deployment.")])
    faulty, clean = [one for one in drives if one.expected], [one for one in drives if not one.expected]
    images = [one.right_images for one in faulty if one.right_images is not None]
    moved = [one.figures["large_refused"] for one in faulty if one.expected == "furniture"]
    title = f"drives with a fault whose first cause is right, of {len(faulty)}"
    found = {
        "drives_right": share_of(title, [bool(one.right) for one in faulty]),
        "images_right": Figure(
            "images with a cause that have the right one, means over drives", _mean(images), "%", True
        ),
        "clean_refused": Figure("refused without a change", _mean([1.0 - one.accepted for one in clean]), "%"),
        "moved_refused": Figure("errors > 10 cm refused, furniture moved", _mean(moved), "%", at_least=True),
    }
    for cause in ("other_room", "covered"):
        refused = [1.0 - one.accepted for one in faulty if one.expected == cause]
        found[f"{cause}_refused"] = Figure(f"refused, {TITLES[cause]}", _mean(refused), "%", at_least=True)
    return {name: figure for name, figure in found.items() if figure.value is not None}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw the share of the images of each fault with each cause, as a matrix for each training with all faults."""
    every = {title: read_drives(some, varied) for title, some in split_trainings(rows).items()}
    most = max(map(len, every.values()))
    shown = {title: drives for title, drives in every.items() if len(drives) == most}
    picture = Picture(figsize=(1.8 + 3.7 * len(shown), 2.2 + 0.27 * most), layout="constrained")
    panels = picture.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, (title, drives) in zip(panels, shown.items(), strict=True):
        _draw_matrix(axes, drives)
        axes.set_title(title, fontsize=9)
    picture.supxlabel("images with each cause [%]; framed: the cause that should be named", fontsize=8)
    return picture


def _draw_matrix(axes: Axes, drives: Sequence[JudgedDrive]) -> None:
    names = list(TITLES)
    share = np.array([[drive.shares.get(name, 0.0) for name in names] for drive in drives])
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for row, column in np.argwhere(share >= 0.005).tolist():
        colour = "white" if share[row, column] > 0.5 else "black"
        axes.text(column, row, f"{100 * share[row, column]:.0f}", ha="center", va="center", size=7, color=colour)
    for row, drive in enumerate(drives):
        if drive.expected:
            corner = (names.index(drive.expected) - 0.5, row - 0.5)
            axes.add_patch(Rectangle(corner, 1.0, 1.0, fill=False, edgecolor="#d9822b", lw=1.4))
    axes.set_xticks(range(len(names)), [TITLES[name] for name in names], rotation=40, ha="right", fontsize=8)
    axes.set_yticks(range(len(drives)), [drive.fault for drive in drives], fontsize=8)
    axes.tick_params(length=0)


def split_trainings(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by method, features and room."""
    return {
        f"{title_of(method)}, features of {values}, {room}": list(same)
        for method, ours in split_by(rows, "method").items()
        for values, some in split_by([{VALUES: "ranks", ROOM: "one room", **row} for row in ours], VALUES).items()
        for room, same in split_by(some, ROOM).items()
    }
