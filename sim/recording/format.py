"""The format of a recording on disk: what the robot sensed and, in separate files, the ground truth if there is one.

A recording is a folder with ``manifest.json`` (written last: without it the recording is not finished); for each sensor
``observations/<sensor>.npy`` (N, ...) and ``observations/<sensor>_time.npy`` (N,), and at test positions
``test/<sensor>.npy`` (C, H, ...); ``reading.npy`` (R, 4) and ``time.npy`` (R,) of the encoders; ``labels/``, if
a tag camera made some; for a simulation, ``scene.glb`` and ``truth/``. The folder ``use/`` holds the deployment drive,
if there is one: a recording of its own, whose manifest's checksum is in the outer manifest.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from sim.errors import DamagedError, InputError, one_line
from sim.files.atomic import list_files, remove_files
from sim.files.checksums import FORMAT, check_sha256, damaged, read_json, refuse_format, sha256, write_array, write_json
from sim.geometry import FreeSpace, load_free_space
from sim.recording.manifest import DEPLOYMENT_FOLDER, DIMENSIONS, SENSOR, Manifest, ObservationKind, describe_problem
from sim.recording.turns import FILE as TURNS
from sim.recording.turns import Turns, check_turns, from_array

OWN_PATH = re.compile(
    rf"manifest\.json|scene\.glb|(observations|test)/{SENSOR}\.npy|(reading|time|turns)\.npy"
    r"|truth/(pose|reading|wheel_angle|state|test_pose|landmark|obstacle)\.npy|truth/free_space\.npz"
    r"|labels/((test_)?detection|tag)\.npz|labels/(test_)?pose\.npy"
)
"""Paths of a recording's files, without those of the deployment drive."""
RECORDING = re.compile(rf"({DEPLOYMENT_FOLDER}/)?({OWN_PATH.pattern})")  # Paths of all files of a recording
PART = re.compile(rf"drive-\d+\.npz|(image|test|turn)-\d+(\.{SENSOR})?\.np[yz]")
"""Names of the parts of a drive, without those of the deployment drive."""
WORK_PATH = re.compile(rf"({DEPLOYMENT_FOLDER}/)?({PART.pattern})")  # Of all files of an unfinished one
DEPLOYMENT_MANIFEST = f"{DEPLOYMENT_FOLDER}/manifest.json"  # Path of the manifest of the deployment drive
RUN_RECORDING = "recording"  # Name of the folder of a run's recording; other recordings have names of their own
Report = Callable[[str, int, int], None]  # Called with a stage of the work, the steps done and their number
REPAIR_HINT = "restore it from a copy, or, if the simulator made it, make it again with --fresh"


@dataclass(frozen=True)
class Recording:
    """What the robot sensed; nothing here reveals where it was."""

    folder: Path  # Its folder
    manifest: Manifest  # Settings, seeds, counts, odometry constants, checksums
    # Observations of the first sensor, from which methods learn; memory-mapped. Polar images (N, rings, sectors, 3)
    # uint8, lidar scans (N, headings, rays) or distances to landmarks (N, landmarks), both float32
    observation: np.ndarray
    reading: np.ndarray  # int64 (R, 4): segment, observation, cumulative left ticks, cumulative right ticks
    time: np.ndarray  # Time of each reading (R,) [s]
    test_observation: np.ndarray  # Observations at test positions (C) and headings (H): (C, H, ...), memory-mapped
    observation_time: np.ndarray | None = None  # Time of each observation (N,) [s]; NaN where it is not known
    # Observations of the other sensors by name (N, ...), memory-mapped; a tag camera has grey images
    others: Mapping[str, np.ndarray] = field(default_factory=dict)
    turns: Turns | None = None  # What the robot knows of its turns; None: nothing, as in those of landmarks
    # Observations of the first sensor after turns in place (K, ...), memory-mapped; None like ``turns``
    turn_observation: np.ndarray | None = None

    @property
    def kind(self) -> ObservationKind | None:
        """Kind of the first sensor's observations."""
        return self.manifest.kind


Judge = Callable[[Recording], bool]  # Says whether what was driven so far is enough


@dataclass(frozen=True)
class Labels:
    """Poses measured by the tag camera, in an arbitrary frame; NaN where it saw too few tags."""

    pose: np.ndarray  # Pose at each observation (N, 3): x, y [m], yaw [rad]
    test_pose: np.ndarray  # Pose at each test image (C, H, 3)


@dataclass(frozen=True)
class Truth:
    """The simulator's ground truth; only evaluation, the supervised baselines and the viewer open it."""

    pose: np.ndarray  # Pose at each observation (N, 3): x, y [m], yaw [rad]
    reading: np.ndarray  # Segment and observation of each reading (Q, 2), including those that never arrived
    wheel_angle: np.ndarray  # Wheel-joint angles at each of these readings (Q, 2): left, right [rad]
    test_pose: np.ndarray  # Pose at each test image (C, H, 3)
    free_space: FreeSpace  # Where the robot fits


def open_recording(folder: Path, manifest: Manifest | None = None) -> Recording:
    """Open what the robot sensed and compare its files with their checksums.

    An unfinished one needs its manifest. Raises InputError if the folder is not a finished recording, or one of its
    files is damaged.
    """
    manifest = manifest or read_manifest(folder)
    _check_files(folder, manifest, truth=False)
    if not manifest.sensors:
        raise InputError(f"{folder / 'manifest.json'}: sensors must name at least one sensor")
    first, *others = manifest.sensors
    reading, time = _open_array(folder / "reading.npy"), _open_array(folder / "time.npy")
    observation = _open_observations(folder, manifest, first)
    stamps = folder / time_file(first)
    return Recording(
        folder=folder,
        manifest=manifest,
        observation=observation,
        reading=reading,
        time=time,
        test_observation=_open_array(folder / grid_file(first), mapped=True),
        observation_time=_open_array(stamps) if stamps.is_file() else stamp(reading[:, 1], time, len(observation)),
        others={name: _open_observations(folder, manifest, name) for name in others},
        **_open_turns(folder, first, reading, len(observation)),
    )


def observation_file(sensor: str) -> str:
    """Path of a sensor's observations in a recording's folder."""
    return f"observations/{sensor}.npy"


def time_file(sensor: str) -> str:
    """Path of the times of a sensor's observations."""
    return f"observations/{sensor}_time.npy"


def grid_file(sensor: str) -> str:
    """Path of a sensor's observations at test positions."""
    return f"test/{sensor}.npy"


def turn_file(sensor: str) -> str:
    """Path of a sensor's observations after turns in place."""
    return f"observations/{sensor}_turn.npy"


def measure_driven(segment: np.ndarray, travelled_m: np.ndarray) -> float:
    """Distance driven along all segments [m], from the segment and the distance travelled at each reading (R,) [m]."""
    return round(float(np.abs(np.diff(travelled_m)[np.diff(segment) == 0]).sum()), 3)


def stamp(observation: np.ndarray, time: np.ndarray, count: int) -> np.ndarray:
    """Times of observations (count,) [s]: those of their first readings (R,); NaN where there is none."""
    found = np.full(count, np.nan)
    if observation.shape == time.shape:
        there = (observation >= 0) & (observation < count)
        found[observation[there][::-1]] = time[there][::-1]
    return found


def open_truth(folder: Path) -> Truth:
    """Open a recording's ground truth and compare its files with their checksums; raises like ``open_recording``."""
    manifest, truth = read_manifest(folder), folder / "truth"
    if not has_truth(folder, manifest):
        raise InputError(f"{folder} has no truth, and errors, labels from it and the room cannot be shown without")
    _check_files(folder, manifest, truth=True)
    return Truth(
        pose=_open_array(truth / "pose.npy"),
        reading=_open_array(truth / "reading.npy"),
        wheel_angle=_open_array(truth / "wheel_angle.npy"),
        test_pose=_open_array(truth / "test_pose.npy"),
        free_space=load_free_space(truth / "free_space.npz"),
    )


def has_truth(folder: Path, manifest: Manifest | None = None) -> bool:
    """Whether a recording holds the ground truth; that of a real robot does not."""
    names = (manifest or read_manifest(folder)).sha256
    return (folder / "truth").is_dir() or any(name.startswith("truth/") for name in names)


def open_labels(folder: Path) -> Labels | None:
    """Open a recording's labels, if it has any."""
    labels = folder / "labels"
    if not labels.is_dir():
        return None
    return Labels(pose=_open_array(labels / "pose.npy"), test_pose=_open_array(labels / "test_pose.npy"))


def work_folder(folder: Path) -> Path:
    """Folder for the parts of an unfinished recording."""
    return folder.with_name(f"{folder.name}.collecting")


def name_source(base: Path) -> str:
    """How a manifest calls the recording from which another was derived: by its own folder, or that of its run."""
    home = base.parent if base.name == DEPLOYMENT_FOLDER else base
    return home.parent.name if home.name == RUN_RECORDING else home.name


def is_whole(folder: Path) -> bool:
    """Whether a recording is finished and its parts have been removed."""
    return (folder / "manifest.json").is_file() and not list_files(work_folder(folder), WORK_PATH)


def chunk_files(work: Path, index: int) -> tuple[Path, Path, Path]:
    """Files of one chunk of an unfinished recording: states and readings, images, and images after turns."""
    drive, image, turn = (work / f"{name}-{index:06d}.npz" for name in ("drive", "image", "turn"))
    return drive, image, turn


def read_manifest(folder: Path) -> Manifest:
    """Read a recording's manifest; raises InputError if it is missing, damaged or of another format."""
    path = folder / "manifest.json"
    if not path.is_file():
        raise InputError(f"{folder} is no finished recording: it has no manifest.json")
    try:
        values = read_json(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; {REPAIR_HINT}") from None
    if values.get("format") != FORMAT:
        raise refuse_format(path, values.get("format"))
    try:
        manifest = Manifest.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {describe_problem(error)}") from None
    if not all(RECORDING.fullmatch(name) for name in manifest.sha256):
        raise InputError(f"{path}: sha256 must be a mapping from names of a recording's files")
    return manifest


def write_files(folder: Path, arrays: Mapping[str, np.ndarray], manifest: Mapping[str, Any]) -> None:
    """Write a recording's arrays, given by their paths in the folder, then its manifest with their checksums."""
    for name, array in arrays.items():
        write_array(folder / name, array)
    finish_recording(folder, manifest)


def finish_recording(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Complete the recording: write its manifest with checksums."""
    write_json(folder / "manifest.json", add_checksums(folder, manifest))


def add_checksums(folder: Path, manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest with the SHA-256 of each file of a recording and of a deployment drive's manifest."""
    names = sorted(path.relative_to(folder).as_posix() for path in list_files(folder, RECORDING))
    ours = [
        name for name in names if (OWN_PATH.fullmatch(name) and name != "manifest.json") or name == DEPLOYMENT_MANIFEST
    ]
    checksums = {name: sha256(folder / name) for name in ours}
    return {**manifest, "format": FORMAT, "sha256": checksums}


def check_recording(folder: Path) -> None:
    """Compare every file with the manifest's checksum; raises DamagedError that names the first that differs."""
    manifest = read_manifest(folder)
    for truth in (False, True):
        _check_files(folder, manifest, truth)
    if DEPLOYMENT_MANIFEST in manifest.sha256:
        check_recording(folder / DEPLOYMENT_FOLDER)


def remove_recording(folder: Path) -> None:
    """Remove a recording, finished or not, and its parts; any other files in its folders stay."""
    for place, ours in ((folder, RECORDING), (work_folder(folder), WORK_PATH)):
        if place.is_dir() and not place.is_symlink():
            remove_files(place, ours)


def _check_files(folder: Path, manifest: Manifest, truth: bool) -> None:
    """Compare the files of the ground truth, or all others, with the manifest's checksums."""
    for name, expected in manifest.sha256.items():
        if name.startswith("truth/") == truth:
            try:
                check_sha256(folder / name, expected)
            except DamagedError as error:
                raise DamagedError(f"{error}; {REPAIR_HINT}") from None


def _open_observations(folder: Path, manifest: Manifest, sensor: str) -> np.ndarray:
    name, kind = observation_file(sensor), manifest.sensors[sensor]
    array = _open_array(folder / name, mapped=True)
    if array.ndim != DIMENSIONS[kind]:
        raise InputError(
            f"{folder / name} has {array.ndim} axes, and observations of kind {kind} have {DIMENSIONS[kind]}"
        )
    return array


def _open_turns(folder: Path, sensor: str, reading: np.ndarray, observations: int) -> dict[str, Any]:
    if not (folder / TURNS).is_file():
        return {}
    turns, seen = _open_array(folder / TURNS), _open_array(folder / turn_file(sensor), mapped=True)
    if reading.ndim == 2:  # otherwise nothing can be learned, as checks of the readings say
        try:
            check_turns(turns, observations, len(seen), reading[:, 0])
        except InputError as error:
            raise InputError(f"{folder / TURNS}: {error}") from None
    return {"turns": from_array(turns), "turn_observation": seen}


def _open_array(path: Path, mapped: bool = False) -> np.ndarray:
    try:
        # Mode "c" makes the array writable in memory, as torch requires; the file does not change.
        return np.load(path, mmap_mode="c" if mapped else None, allow_pickle=False)
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing; {REPAIR_HINT}") from None
    except (ValueError, EOFError, MemoryError, OverflowError) as error:
        raise damaged(path, one_line(error)) from None
