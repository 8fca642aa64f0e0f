"""The drives of the report "knowing": those of runs, those that are derived from them, and what is said of each.

Images of the deployment drive are spoilt, a drive in another room takes its place, and the method is trained without a
part of the map.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from deepgps.config.methods import METHODS, folder_of, title_of
from deepgps.data.segments import find_runs
from deepgps.evaluation.deployment import open_deployment
from deepgps.methods.fit import fit_method
from deepgps.methods.train import training_seed
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.run_report import read_metrics
from deepgps.runs.run_folder import open_run
from deepgps.studies.reports.changes import DRIVES
from deepgps.studies.table import LEVELS, Row
from deepgps.terminal.progress import Report, ignore
from deepgps.tracking.causes import TITLES, Causes, make_monitor
from sim.errors import InputError
from sim.files.checksums import read_arrays
from sim.recording.format import Recording, open_recording
from sim.recording.turns import KINDS, NO_IMAGE, Turns, from_array

EXPECTED_CAUSES = {
    "light": ("deployment.light", "deployment.lamps", "deployment.exposure"),
    "furniture": ("deployment.moved_m",),
    "camera": ("deployment.camera_mount.roll_deg",),
}
"""The cause that should be named, and the settings that bring it about."""
LARGE_ERROR_M = 0.1
SEEN_SHARE, MIN_SEGMENTS = 0.7, 10
"""Share of the map that is learned for the drive that goes beyond it; with fewer segments it is left out."""
Spoil = Callable[[np.ndarray], np.ndarray]
TRANSMITTED_SHARE = 0.04  # Share of the light that a covered lens lets through; the rest is scattered evenly


def cover(images: np.ndarray) -> np.ndarray:
    """Images (N, rings, sectors, 3) through a cover: half as bright, and nearly uniform."""
    mean = images.mean(axis=(1, 2), keepdims=True)
    return np.rint((TRANSMITTED_SHARE * images + (1.0 - TRANSMITTED_SHARE) * mean) / 2.0).astype(np.uint8)


SPOILS: Mapping[str, Spoil] = {
    "black": np.zeros_like,
    "white": lambda images: np.full_like(images, 255),
    "covered": cover,
    "frozen": lambda images: np.repeat(images[:1], len(images), axis=0),
}
"""What happens to images (N, rings, sectors, 3), by the cause that should be named."""


def add_drives(run: Path, row: Row, progress: Report = ignore) -> Row:
    """Deployment drives of a run as JSON in one column: its own, and those derived from it if nothing has changed."""
    use = read_metrics(run)["methods"][row["method"]].get("in_use", {})
    if "causes" not in use:
        raise InputError(
            f"{run}: the report knowing needs a deployment drive, and methods that refuse images and name causes, "
            f"which {title_of(row['method'])} does not"
        )
    expected = find_expected(row)
    own = {
        "fault": "",  # What is wrong, in words; empty: what the run's settings change
        "expected": expected,  # The cause that should be named; empty: none
        "accepted": use["accepted"],  # Share of the images
        "causes": use["causes"],  # As ``Causes.summarise`` returns them
        "figures": measure_use(run, row),  # Coverage of the radii and refusal of large errors; empty: not measured
    }
    derived = derive_drives(run, row["method"], progress) if not expected else ()
    return {DRIVES: json.dumps([own, *derived])}


def find_expected(row: Row) -> str:
    """The cause that should be named in a run's own drive; empty: none."""
    usual = {"deployment.exposure": "fixed", "deployment.moved_m": 0.0, "deployment.camera_mount.roll_deg": None}
    for cause, names in EXPECTED_CAUSES.items():
        if any(name in row and row[name] != usual.get(name, 1.0) for name in names):
            return cause
    return ""


def measure_use(run: Path, row: Row) -> dict[str, float | None]:
    """What radii hold on the grid and in deployment, and the share of errors above 10 cm there that is refused."""
    method, arrays = row["method"], read_arrays(run / "use_field.npz")
    use = read_metrics(run)["methods"][method]["in_use"]
    large = np.linalg.norm(arrays[method] - arrays["truth"][:, None], axis=-1) > LARGE_ERROR_M
    refused = ~arrays[f"accepted/{method}"][large]
    return {
        **{
            f"{where}_{level}": of.get(f"radius_{level}_holds")
            for where, of in (("grid", row), ("use", use))
            for level in LEVELS
        },
        "large_refused": float(refused.mean()) if len(refused) else None,
    }


def derive_drives(run: Path, method: str, progress: Report) -> Iterator[dict[str, Any]]:
    """Drives that are made from a run's own, or from those of other rooms, and what is said of them."""
    recording = open_recording(run / "recording")
    drive, monitor = open_deployment(recording), make_monitor(load_positioner(folder_of(run, method)), recording)
    if drive is None or monitor is None:
        return
    for cause, spoil in SPOILS.items():
        yield describe(TITLES[cause], cause, monitor.name(spoil_drive(drive, spoil)))
    for other in find_other_rooms(run, recording):
        yield describe(TITLES["other_room"], "other_room", monitor.name(other))
    position = monitor.positioner.locate_camera(recording.observation)
    part = keep_segments(recording, position[:, 0] < np.quantile(position[:, 0], SEEN_SHARE))
    # labels are of all images
    if METHODS[method].map != "labels" and len(np.unique(part.reading[:, 0])) >= MIN_SEGMENTS:
        scenario = open_run(run)
        with TemporaryDirectory() as folder:
            taught = fit_method(method, part, scenario.learn, training_seed(scenario), Path(folder) / method, progress)
            beyond = make_monitor(taught, part)
            assert beyond is not None
            yield describe("a part not driven", "new_place", beyond.name(drive))


def find_other_rooms(run: Path, recording: Recording) -> Iterator[Recording]:
    """The deployment drive of the first other recording of the study that is of another room."""
    room = recording.manifest.settings["room"]
    for folder in sorted((run.parent.parent / "recordings").glob("*/manifest.json")):
        other = open_recording(folder.parent)
        if other.manifest.settings["room"] != room and (drive := open_deployment(other)) is not None:
            yield drive
            return


def describe(fault: str, expected: str, causes: Causes) -> dict[str, Any]:
    """What is said of a drive that is derived, as of a run's own."""
    accepted, summary = float(causes.accepted.mean()), causes.summarise()
    return {"fault": fault, "expected": expected, "accepted": accepted, "causes": summary, "figures": {}}


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
    """The turns between segments that followed each other, and one relocation for each gap, after only rows (R,) of the
    readings and these observations are kept; ``reading`` (R, 4) numbers them again."""
    first = np.flatnonzero(np.diff(reading[:, 0])) + 1
    jump = {row: (reading[row - 1, 1], NO_IMAGE, row, KINDS.index("relocated")) for row in first.tolist()}
    follows = np.isin(turns.after, rows) & np.isin(turns.after - 1, rows)
    for before, image, after, kind in turns.array[follows].tolist():
        row = int(np.searchsorted(rows, after))
        jump[row] = (int(np.searchsorted(observed, before)), image, row, kind)
    return from_array(np.array(list(jump.values()), np.int64).reshape(-1, 4))
