"""The report of what a method knows of itself: what is refused of each fault, what is named, what the radii hold.

Its drives are a run's own, and those derived from it: images of the drive in use are spoilt, a drive in another room
takes its place, and the method is trained without a part of the map. A table keeps them as JSON.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from matplotlib.patches import Rectangle

from deepgps.config.methods import METHODS, folder_of, title_of
from deepgps.data.segments import find_runs
from deepgps.evaluation.in_use import open_drive_in_use
from deepgps.methods.fit import fit_method
from deepgps.methods.train import training_seed
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, share_of, write
from deepgps.runs.run_folder import open_run
from deepgps.studies.reports.changes import group_changes
from deepgps.studies.table import LEVELS, Row, split_by
from deepgps.tracking.causes import TITLES, Causes, make_monitor
from sim.errors import InputError
from sim.files.checksums import read_arrays
from sim.recording.format import Recording, open_recording
from sim.recording.turns import KINDS, NO_IMAGE, Turns, from_array

EXPECTED = {
    "light": ("deployment.light", "deployment.lamps", "deployment.exposure"),
    "furniture": ("deployment.moved_m",),
    "camera": ("deployment.camera_mount.roll_deg",),
}
"""The cause that should be named, and the settings that bring it about."""
COLUMN, LARGE_M = "drives", 0.1
SEEN, FEWEST = 0.7, 10
"""Share of the map that is learned for the drive that goes beyond it; with fewer segments it is left out."""
Spoil = Callable[[np.ndarray], np.ndarray]
THROUGH = 0.04
"""Share of the light that a covered lens lets through from where it comes; the rest is scattered evenly."""
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


def cover(images: np.ndarray) -> np.ndarray:
    """Images (N, rings, sectors, 3) through a cover: half as bright, and nearly uniform."""
    mean = images.mean(axis=(1, 2), keepdims=True)
    return np.rint((THROUGH * images + (1.0 - THROUGH) * mean) / 2.0).astype(np.uint8)


SPOILT: Mapping[str, Spoil] = {
    "black": np.zeros_like,
    "white": lambda images: np.full_like(images, 255),
    "covered": cover,
    "frozen": lambda images: np.repeat(images[:1], len(images), axis=0),
}
"""What happens to images (N, rings, sectors, 3), by the cause that should be named."""


class JudgedDrive(NamedTuple):
    """What is said of one drive in use.

    Attributes:
        fault: What is wrong with it, in words.
        expected: The cause that should be named; empty: none.
        accepted: Share of its images that are accepted.
        causes: What ``Causes.summarise`` returns.
        figures: Coverage of the radii and refusal of large errors, by name; empty where they are not measured.
    """

    fault: str
    expected: str
    accepted: float
    causes: Mapping[str, Any]
    figures: Mapping[str, float | None]

    @property
    def shares(self) -> dict[str, float]:
        """Share of the images with each cause; a lean is one of all images."""
        return {**self.causes["shares"], **({"camera": 1.0} if "camera" in self.causes["named"] else {})}

    @property
    def right(self) -> bool:
        """Whether the drive's first cause is the expected one."""
        named = self.causes["named"]
        return named[:1] == [self.expected] if self.expected else not named

    @property
    def right_images(self) -> float | None:
        """Share of the images with a cause that have the expected one; None: no image has a cause."""
        if self.expected == "camera":
            return self.shares.get("camera", 0.0)
        shares = self.causes["shares"]
        return shares.get(self.expected, 0.0) / sum(shares.values()) if shares else None


def add_drives(run: Path, row: Row) -> Row:
    """The drives in use of a run as JSON in one column: its own, and those derived from it if nothing has changed."""
    use = read_metrics(run)["methods"][row["method"]].get("in_use", {})
    if "causes" not in use:
        raise InputError(
            f"{run}: the report knowing needs a drive in use, and methods that refuse images and name causes, which "
            f"{title_of(row['method'])} does not"
        )
    expected = find_expected(row)
    own = JudgedDrive("", expected, use["accepted"], use["causes"], measure_use(run, row))
    derived = derive_drives(run, row["method"]) if not expected else ()
    return {COLUMN: json.dumps([drive._asdict() for drive in (own, *derived)])}


def find_expected(row: Row) -> str:
    """The cause that should be named in a run's own drive; empty: none."""
    usual = {"deployment.exposure": "fixed", "deployment.moved_m": 0.0, "deployment.camera_mount.roll_deg": None}
    for cause, names in EXPECTED.items():
        if any(name in row and row[name] != usual.get(name, 1.0) for name in names):
            return cause
    return ""


def measure_use(run: Path, row: Row) -> dict[str, float | None]:
    """What radii hold on the grid and in use, and the share of the errors in use above 10 cm that is refused."""
    method, arrays = row["method"], read_arrays(run / "use_field.npz")
    use = read_metrics(run)["methods"][method]["in_use"]
    large = np.linalg.norm(arrays[method] - arrays["truth"][:, None], axis=-1) > LARGE_M
    refused = ~arrays[f"accepted/{method}"][large]
    return {
        **{
            f"{where}_{level}": of.get(f"radius_{level}_holds")
            for where, of in (("grid", row), ("use", use))
            for level in LEVELS
        },
        "large_refused": float(refused.mean()) if len(refused) else None,
    }


def derive_drives(run: Path, method: str) -> Iterator[JudgedDrive]:
    """Drives that are made from a run's own, or from those of other rooms, and what is said of them."""
    recording = open_recording(run / "recording")
    drive, monitor = open_drive_in_use(recording), make_monitor(load_positioner(folder_of(run, method)), recording)
    if drive is None or monitor is None:
        return
    for cause, spoil in SPOILT.items():
        yield describe(TITLES[cause], cause, monitor.name(spoil_drive(drive, spoil)))
    for other in find_other_rooms(run, recording):
        yield describe(TITLES["other_room"], "other_room", monitor.name(other))
    position = monitor.positioner.locate_camera(recording.observation)
    part = keep_segments(recording, position[:, 0] < np.quantile(position[:, 0], SEEN))
    learns = METHODS[method].reads_ticks  # others learn from labels, which are of all images
    if learns and len(np.unique(part.reading[:, 0])) >= FEWEST:
        scenario = open_run(run)
        with TemporaryDirectory() as folder:
            taught = fit_method(method, part, scenario.learn, training_seed(scenario), Path(folder) / method)
            beyond = make_monitor(taught, part)
            assert beyond is not None
            yield describe("a part not driven", "new_place", beyond.name(drive))


def find_other_rooms(run: Path, recording: Recording) -> Iterator[Recording]:
    """The drive in use of the first other recording of the study that is of another room."""
    room = recording.manifest.settings["room"]
    for folder in sorted((run.parent.parent / "recordings").glob("*/manifest.json")):
        other = open_recording(folder.parent)
        if other.manifest.settings["room"] != room and (drive := open_drive_in_use(other)) is not None:
            yield drive
            return


def describe(fault: str, expected: str, causes: Causes) -> JudgedDrive:
    return JudgedDrive(fault, expected, float(causes.accepted.mean()), causes.summarise(), {})


def read_drives(rows: Sequence[Row], varied: Sequence[str]) -> list[JudgedDrive]:
    """All drives of some rows, each with its fault in words."""
    return [
        drive if drive.fault else drive._replace(fault=change)
        for change, same in group_changes(rows, varied).items()
        for row in same
        for drive in (JudgedDrive(**one) for one in json.loads(row[COLUMN]))
    ]


def spoil_drive(drive: Recording, spoil: Spoil) -> Recording:
    """A drive whose images are spoilt, also those after turns."""
    turned = drive.turn_observation
    turned = None if turned is None or not len(turned) else spoil(np.asarray(turned))
    return replace(drive, observation=spoil(np.asarray(drive.observation)), turn_observation=turned)


def keep_segments(recording: Recording, seen: np.ndarray) -> Recording:
    """A recording without the segments on which any image is not among those seen (N,) bool.

    The robot is taken to be carried over what is left out.
    """
    runs = find_runs(recording)
    kept = [number for number, run in enumerate(runs) if seen[recording.reading[run, 1]].all()]
    rows = np.concatenate([np.empty(0, int), *(runs[number] for number in kept)])
    observed, new = np.unique(recording.reading[rows, 1], return_inverse=True)
    reading = recording.reading[rows].copy()
    reading[:, 0] = np.repeat(np.arange(len(kept)), [len(runs[number]) for number in kept])
    reading[:, 1] = new
    time = recording.observation_time
    return replace(
        recording,
        reading=reading,
        time=recording.time[rows],
        observation=recording.observation[observed],
        observation_time=None if time is None else time[observed],
        turns=None if recording.turns is None else _keep_turns(recording.turns, rows, reading, observed),
    )


def _keep_turns(turns: Turns, rows: np.ndarray, reading: np.ndarray, observed: np.ndarray) -> Turns:
    """The turns between segments that followed each other, and one relocation for each gap.

    Args:
        turns: Those of the complete recording.
        rows: Its readings that are kept (R,).
        reading: These, numbered again (R, 4).
        observed: Its observations that are kept.
    """
    first = np.flatnonzero(np.diff(reading[:, 0])) + 1
    jump = {row: (reading[row - 1, 1], NO_IMAGE, row, KINDS.index("relocated")) for row in first.tolist()}
    follows = np.isin(turns.after, rows) & np.isin(turns.after - 1, rows)
    for before, image, after, kind in turns.array[follows].tolist():
        row = int(np.searchsorted(rows, after))
        jump[row] = (int(np.searchsorted(observed, before)), image, row, kind)
    return from_array(np.array(list(jump.values()), np.int64).reshape(-1, 4))


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
