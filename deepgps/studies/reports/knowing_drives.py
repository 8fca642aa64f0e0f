"""The drives of the study of what a method knows of itself: a run's own, and those that are derived from it.

Images of the drive in use are spoilt, a drive in another room takes its place, and the method is trained without a part
of the map. A table keeps them as JSON.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from deepgps.config.methods import METHODS, folder_of, title_of
from deepgps.data.segments import find_runs
from deepgps.evaluation.in_use import open_drive_in_use
from deepgps.methods.fit import fit_method
from deepgps.methods.train import training_seed
from deepgps.positioner.pose import locate_camera
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.run_report import read_metrics
from deepgps.runs.run_folder import open_run
from deepgps.studies.reports.changes import group_changes
from deepgps.studies.table import LEVELS, Row
from deepgps.tracking.causes import Causes, make_monitor
from deepgps.tracking.rules import TITLES
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
    position = locate_camera(monitor.positioner, recording.observation)
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
        readings=None,
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
