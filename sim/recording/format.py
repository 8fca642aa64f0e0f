"""The recording on disk: what the robot sensed, and apart from it the truth.

A folder with ``manifest.json`` (written last: without it the recording is not finished), ``observation.npy`` (N, ...),
``reading.npy`` (R, 4), ``time.npy`` (R,), ``test/observation.npy`` (C, H, ...), ``scene.glb`` and ``truth/``; where the
robot has a horizontal camera also ``labels/`` and perhaps ``horizontal.npy`` (N, rows, columns).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim.errors import DamagedError, InputError, one_line
from sim.files import (
    check_sha256,
    damaged,
    list_files,
    read_json,
    remove_files,
    sha256,
    write_array,
    write_json,
)
from sim.occupancy import FreeSpace, load_free_space

SCHEMA = 1
RECORDING = re.compile(
    r"manifest\.json|scene\.glb|(test/)?(observation|horizontal)\.npy|(reading|time)\.npy"
    r"|truth/(pose|reading|wheel_angle|state|test_pose|landmark|obstacle)\.npy|truth/free_space\.npz"
    r"|labels/((test_)?sighting|tag)\.npz|labels/(test_)?pose\.npy"
)
"""Paths of all files that a recording's folder holds."""
COLLECTING = re.compile(r"drive-\d+\.npz|(image|test)-\d+(\.tags|\.horizontal)?\.np[yz]")
"""The same of the folder in which a recording is made."""
RECORD_AGAIN = "restore it from a copy, or make the recording again with --fresh"


@dataclass(frozen=True)
class Recording:
    """What the robot sensed; nothing here tells where it was.

    Attributes:
        folder: Where it lies.
        manifest: Settings, seeds, counts, odometry constants, checksums.
        observation: Memory-mapped. Polar images (N, rings, sectors, 3) uint8, scans of a lidar (N, headings, rays)
            or ways to landmarks (N, landmarks), both float32.
        reading: int64 (R, 4): segment, observation, cumulative left ticks, cumulative right ticks.
        time: Time of each reading (R,) [s].
        test_observation: The same at test positions (C) and headings (H): (C, H, ...), memory-mapped.
        horizontal: Grey images (N, rows, columns) uint8 of the horizontal camera, memory-mapped, where they were kept.
    """

    folder: Path
    manifest: Mapping[str, Any]
    observation: np.ndarray
    reading: np.ndarray
    time: np.ndarray
    test_observation: np.ndarray
    horizontal: np.ndarray | None = None


@dataclass(frozen=True)
class Labels:
    """Poses measured by the horizontal camera, in a frame of their own; not a number where it saw too few tags.

    Attributes:
        pose: At each observation (N, 3): x, y [m], yaw [rad].
        test_pose: At each test image (C, H, 3).
    """

    pose: np.ndarray
    test_pose: np.ndarray


@dataclass(frozen=True)
class Truth:
    """The simulator's truth; only evaluation, the supervised baselines and the viewer open it.

    Attributes:
        pose: Pose at each observation (N, 3): x, y [m], yaw [rad].
        reading: Segment and observation of each reading that was made (Q, 2), also of those that never arrived.
        wheel_angle: Wheel-joint angles at each of these readings (Q, 2): left, right [rad].
        test_pose: Pose at each test image (C, H, 3).
        free_space: Where the robot fits.
    """

    pose: np.ndarray
    reading: np.ndarray
    wheel_angle: np.ndarray
    test_pose: np.ndarray
    free_space: FreeSpace


def open_recording(folder: Path) -> Recording:
    """Open what the robot sensed, its files compared with their checksums.

    Raises:
        InputError: The folder is no finished recording, or a file of it is damaged.
    """
    manifest = read_manifest(folder)
    _check_files(folder, manifest, truth=False)
    return Recording(
        folder=folder,
        manifest=manifest,
        observation=_open_array(folder / "observation.npy", mapped=True),
        reading=_open_array(folder / "reading.npy"),
        time=_open_array(folder / "time.npy"),
        test_observation=_open_array(folder / "test" / "observation.npy", mapped=True),
        horizontal=_open_array(kept, mapped=True) if (kept := folder / "horizontal.npy").is_file() else None,
    )


def open_truth(folder: Path) -> Truth:
    """Open a recording's truth, its files compared with their checksums; raises as ``open_recording`` does."""
    _check_files(folder, read_manifest(folder), truth=True)
    truth = folder / "truth"
    return Truth(
        pose=_open_array(truth / "pose.npy"),
        reading=_open_array(truth / "reading.npy"),
        wheel_angle=_open_array(truth / "wheel_angle.npy"),
        test_pose=_open_array(truth / "test_pose.npy"),
        free_space=load_free_space(truth / "free_space.npz"),
    )


def open_labels(folder: Path) -> Labels | None:
    """Open a recording's labels, if it has any."""
    labels = folder / "labels"
    if not labels.is_dir():
        return None
    return Labels(pose=_open_array(labels / "pose.npy"), test_pose=_open_array(labels / "test_pose.npy"))


def work_folder(folder: Path) -> Path:
    """Where a recording keeps its parts until it is finished."""
    return folder.with_name(f"{folder.name}.collecting")


def is_whole(folder: Path) -> bool:
    """Whether a recording is finished, and nothing is left of its making."""
    return (folder / "manifest.json").is_file() and not list_files(work_folder(folder), COLLECTING)


def chunk_files(work: Path, index: int) -> tuple[Path, Path]:
    """States and readings of one chunk of a drive that is being recorded, and its images."""
    return work / f"drive-{index:06d}.npz", work / f"image-{index:06d}.npz"


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read a recording's manifest; raises InputError where it is missing, broken or of another schema."""
    path = folder / "manifest.json"
    if not path.is_file():
        raise InputError(f"{folder} is no finished recording: it has no manifest.json")
    try:
        manifest = read_json(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; {RECORD_AGAIN}") from None
    if manifest.get("schema") != SCHEMA:
        raise InputError(f"{path}: schema {manifest.get('schema')!r}, but this version reads schema {SCHEMA}")
    sums = manifest.get("sha256", {})
    if not isinstance(sums, dict) or not all(RECORDING.fullmatch(name) for name in sums):
        raise InputError(f"{path}: sha256 must be a mapping from names of a recording's files")
    return manifest


def write_recording(folder: Path, arrays: Mapping[str, np.ndarray], manifest: Mapping[str, Any]) -> None:
    """Write a recording's arrays by their names in the folder, then its manifest with their checksums."""
    for name, array in arrays.items():
        write_array(folder / name, array)
    finish_recording(folder, manifest)


def finish_recording(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, which makes the recording whole, with the sha256 of every file in it."""
    names = sorted(path.relative_to(folder).as_posix() for path in list_files(folder, RECORDING))
    checksums = {name: sha256(folder / name) for name in names if RECORDING.fullmatch(name) and name != "manifest.json"}
    write_json(folder / "manifest.json", {"schema": SCHEMA, **manifest, "sha256": checksums})


def check_recording(folder: Path) -> None:
    """Compare every file with the manifest's checksum; raises DamagedError naming the first that differs."""
    manifest = read_manifest(folder)
    for truth in (False, True):
        _check_files(folder, manifest, truth)


def remove_recording(folder: Path) -> None:
    """Remove the files of a recording, finished or not, and of its making; anything else in its folders stays."""
    for place, ours in ((folder, RECORDING), (work_folder(folder), COLLECTING)):
        if place.is_dir() and not place.is_symlink():
            remove_files(place, ours)


def _check_files(folder: Path, manifest: Mapping[str, Any], truth: bool) -> None:
    """Compare the files of the truth, or all others, with the manifest's checksums."""
    for name, expected in manifest.get("sha256", {}).items():
        if name.startswith("truth/") == truth:
            try:
                check_sha256(folder / name, expected)
            except DamagedError as error:
                raise DamagedError(f"{error}; {RECORD_AGAIN}") from None


def _open_array(path: Path, mapped: bool = False) -> np.ndarray:
    try:
        # "c": in memory it may be written, as torch wants of every array; the file stays as it is.
        return np.load(path, mmap_mode="c" if mapped else None, allow_pickle=False)
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing; {RECORD_AGAIN}") from None
    except (ValueError, EOFError, MemoryError, OverflowError) as error:
        raise damaged(path, one_line(error)) from None
