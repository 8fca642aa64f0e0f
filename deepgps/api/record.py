"""A recording of one's own data, as of a real robot: written from arrays, checked, and ready for training."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.spatial import KDTree

from deepgps.config.scenario import Scenario
from deepgps.config.setting_problems import describe_problems
from deepgps.data.checks import check_observations, check_readings
from sim.errors import InputError, quote, shorten
from sim.geometry import FreeSpace, save_free_space
from sim.recording.format import (
    Truth,
    check_recording,
    grid_file,
    measure_driven,
    observation_file,
    stamp,
    time_file,
    turn_file,
    write_files,
)
from sim.recording.manifest import DIMENSIONS, ObservationKind
from sim.recording.turns import FILE as TURNS
from sim.recording.turns import check_turns
from sim.sensors.encoder import check_odometry, ticks_to_distance
from sim.settings import CameraSettings

Values = np.ndarray | Sequence[Any]  # An array, or nested sequences of numbers or arrays
SENSOR_NAMES: dict[ObservationKind, str] = {"polar_image": "fisheye", "scan": "lidar", "vector": "landmarks"}
"""Name of the sensor for each kind of observation that methods learn from."""
SETTINGS: dict[ObservationKind, dict[str, Any]] = {
    "polar_image": {},
    "scan": {"sensor": "lidar"},
    "vector": {"world": "landmarks"},
}
"""Settings that give a scenario these observations."""
CELL_M = 0.02
MAX_CELLS = 25_000_000
FREE_RADIUS_M = 0.15  # Without a map, the floor within this distance of a true pose counts as free [m]


def write_recording(
    folder: str | Path,
    observations: Values,
    readings: Values,
    time: Values,
    odometry: Mapping[str, float],
    *,
    kind: ObservationKind = "polar_image",
    observation_time: Values | None = None,
    turns: Values | None = None,
    turn_observations: Values | None = None,
    test_observations: Values | None = None,
    pose: Values | None = None,
    test_pose: Values | None = None,
    free_space: FreeSpace | None = None,
    camera: CameraSettings | None = None,
    labels: Values | None = None,
    about: Mapping[str, Any] | None = None,
) -> Path:
    """Write a recording of your own data, from which ``deepgps.train`` learns.

    The robot drives straight segments: in between it may turn, back off or be carried. Along each segment the encoders
    are read at every observation.

    Args:
        folder: Where to write it; must be empty or not exist, and no link, mount point or working folder. If writing
            is interrupted, it is not there.
        observations: In the order driven: polar images (N, rings, sectors, 3) uint8, which ``unwrap_fisheye`` makes;
            scans (N, headings, rays) [m]; or vectors such as distances to landmarks (N, M).
        readings: Readings of the encoders (R, 4), int: number of the segment, number of the observation, cumulative
            ticks of the left and of the right wheel. An observation at which one segment ends and the next begins has
            a reading in each.
        time: Time of each reading (R,) [s].
        odometry: ``wheel_radius_m``, ``track_m`` (distance between the wheels) and ``ticks_per_rev``; and, if known,
            ``step_noise`` and ``slip_per_m`` as in ``EncoderSettings``.
        kind: ``polar_image``, ``scan`` or ``vector``.
        observation_time: Time of each observation (N,) [s]; None: that of its first reading.
        turns: What is known of the turns between segments (T, 4), int: the last observation before the turn; the number
            of the turn observation after it, or -1 if there is none; the row of ``readings`` where the next segment
            begins; and 0 if the robot turned in place, 1 if it backed off first, 2 if it was carried. None: nothing.
        turn_observations: Observations taken after turns in place, before the next segment (K, ...).
        test_observations: Observations at test positions (C, H, ...) at H headings, or (C, ...); None: there are none.
        pose: True pose at each observation (N, 3): x, y [m], yaw [rad], for evaluation and supervised methods; None:
            not known, so nothing can be evaluated.
        test_pose: True pose at each test observation (C, H, 3), or (C, 3).
        free_space: Where the robot fits, for figures and the viewer; None: within 0.15 m of a pose.
        camera: The fisheye camera's field of view and lens, by which the compass compares images.
        labels: Measured pose at each observation (N, 3), NaN where there is none, from which supervised methods learn;
            None: they learn from ``pose``.
        about: More entries of the manifest, such as ``source``.

    Returns:
        The folder.

    Raises:
        InputError: The folder is not empty, an array has the wrong shape, or the readings are impossible.
    """
    folder = Path(folder)
    check_place(folder)
    if kind not in SENSOR_NAMES:
        raise InputError(f"kind {quote(kind)}: must be {', '.join(SENSOR_NAMES)}")
    observation, sensor = _take(observations, DIMENSIONS[kind], "observations", kind), SENSOR_NAMES[kind]
    reading, seconds = np.asarray(readings), np.asarray(time, float)
    check_readings(reading, seconds, len(observation), check_odometry(odometry))
    reading = reading.astype(np.int64)
    test = _take_tests(test_observations, observation, DIMENSIONS[kind])
    turned = _take_turns(turns, turn_observations, observation, reading)
    stamps = stamp(reading[:, 1], seconds, len(observation)) if observation_time is None else observation_time
    arrays = {
        observation_file(sensor): observation,
        time_file(sensor): _shaped(stamps, (len(observation),), "observation_time"),
        grid_file(sensor): test,
        "reading.npy": reading,
        "time.npy": seconds,
    }
    if turned is not None:
        arrays |= {TURNS: turned[0], turn_file(sensor): turned[1]}
    travelled_m = ticks_to_distance(reading[:, 2:], odometry["wheel_radius_m"], odometry["ticks_per_rev"])
    if labels is not None:
        arrays["labels/pose.npy"] = _shaped(labels, (len(observation), 3), "labels")
        arrays["labels/test_pose.npy"] = np.full((*test.shape[:2], 3), np.nan)
    known = _take_truth(pose, test_pose, free_space, reading, observation, test)
    manifest = {
        "sensors": {sensor: kind},
        "settings": _describe(kind, test, camera, observation),
        "samples": len(observation),
        "segments": len(np.unique(reading[:, 0])),
        "readings": len(reading),
        "distance_driven_m": measure_driven(reading[:, 0], travelled_m.mean(axis=1)),
        "odometry": dict(odometry),
        **(about or {}),
    }
    if known is not None:
        arrays |= {"truth/pose.npy": known.pose, "truth/test_pose.npy": known.test_pose}
        arrays |= {"truth/reading.npy": known.reading, "truth/wheel_angle.npy": known.wheel_angle}
    with write_aside(folder) as place:
        if known is not None:
            save_free_space(place / "truth" / "free_space.npz", known.free_space)
        write_files(place, arrays, manifest)
        check_recording(place)
    return folder


def check_place(folder: Path) -> None:
    """Raise InputError if a finished recording could not be moved to this place."""
    try:
        above = next(place for place in folder.absolute().parents if place.exists())
        if not above.is_dir():
            why = f"cannot be made: {shorten(str(above), 300)} is no folder"
        elif folder.is_symlink():
            why = "is a link"
        elif folder.absolute().is_mount():
            why = "is a mount point"
        elif folder.exists() and folder.samefile("."):
            why = "is the working folder"
        elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            why = "is not empty"
        else:
            return
    except OSError as error:
        why = f"cannot be read: {error.strerror}"
    raise InputError(f"{shorten(str(folder), 300)} {why}; a recording is written to a folder of its own")


@contextmanager
def write_aside(folder: Path) -> Iterator[Path]:
    """Make a place beside a folder, to which what is written there moves at the end; a failure leaves nothing of it."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name[:60]}.") as aside:
        place = Path(aside) / "recording"
        yield place
        if folder.exists():
            folder.rmdir()
        place.replace(folder)


def _take(values: Any, axes: int, name: str, kind: ObservationKind) -> np.ndarray:
    array = np.asarray(values)
    if array.ndim != axes or 0 in array.shape[1:]:
        raise InputError(f"{name} {array.shape}: observations of kind {kind} have {axes} axes, none of them empty")
    if kind == "polar_image" and (array.dtype != np.uint8 or array.shape[-1] != 3):
        raise InputError(f"{name} {array.shape} {array.dtype}: must be (N, rings, sectors, 3) uint8 RGB")
    check_observations(array, name)
    return np.ascontiguousarray(array) if kind == "polar_image" else array.astype(np.float32, order="C")


def _take_tests(values: Any, observation: np.ndarray, axes: int) -> np.ndarray:
    if values is None:
        return np.empty((0, 1, *observation.shape[1:]), observation.dtype)
    test = np.asarray(values)
    test = test[:, None] if test.ndim == axes else test
    if test.shape[2:] != observation.shape[1:] or 0 in test.shape:
        raise InputError(
            f"test_observations {test.shape}: must be (C, H, ...) or (C, ...) with observations of shape "
            f"{observation.shape[1:]}, as in observations"
        )
    return _as_observed(test, observation, "test_observations")


def _as_observed(array: np.ndarray, observation: np.ndarray, name: str) -> np.ndarray:
    check_observations(array, name)
    if observation.dtype == np.uint8 and array.dtype != np.uint8:
        raise InputError(f"{name} {array.dtype}: must be uint8, as observations are")
    return array.astype(observation.dtype)


def _shaped(values: Any, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = np.asarray(values, float)
    if array.shape != shape:
        raise InputError(f"{name} {array.shape}: must have the shape {shape}")
    return array


def _take_turns(
    turns: Any, turn_observations: Any, observation: np.ndarray, reading: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    if turns is None:
        if turn_observations is not None:
            raise InputError("turn_observations need turns, which say where each was taken")
        return None
    seen = observation[:0] if turn_observations is None else np.asarray(turn_observations)
    if seen.shape[1:] != observation.shape[1:]:
        raise InputError(f"turn_observations {seen.shape}: must be like observations, (K, ...) {observation.shape[1:]}")
    seen, array = _as_observed(seen, observation, "turn_observations"), np.asarray(turns)
    check_turns(array, len(observation), len(seen), reading[:, 0])
    return array.astype(np.int64), seen


def _describe(
    kind: ObservationKind, test: np.ndarray, camera: CameraSettings | None, observation: np.ndarray
) -> dict[str, Any]:
    settings = dict(SETTINGS[kind])
    if kind != "vector" and len(test):
        settings["grid"] = {"held_out": len(test)}  # test positions need not form a grid
    if kind == "polar_image":
        rings, sectors = observation.shape[1:3]
        given = {} if camera is None else camera.model_dump(exclude_unset=True)
        settings["camera"] = {**given, "rings": rings, "sectors": sectors}
    try:
        Scenario.model_validate({"name": "recording", **settings})
    except ValidationError as error:
        arrays = f"observations {observation.shape}, test_observations {test.shape}"
        raise InputError(f"{arrays}: {describe_problems(error, Scenario)}") from None
    return settings


def _take_truth(
    pose: Any, test_pose: Any, space: FreeSpace | None, reading: np.ndarray, observation: np.ndarray, test: np.ndarray
) -> Truth | None:
    if pose is None:
        if test_pose is not None or space is not None:
            raise InputError("pose: test_pose and free_space need the true pose of each observation as well")
        return None
    pose = _shaped(pose, (len(observation), 3), "pose")
    wanted = (*test.shape[:2], 3)
    if test_pose is None and len(test):
        raise InputError(f"test_pose: {len(test)} test positions need their poses {wanted}")
    given = np.empty(wanted) if test_pose is None else np.asarray(test_pose, float)
    tests = _shaped(given[:, None] if given.ndim == 2 else given, wanted, "test_pose")
    if not (np.isfinite(pose).all() and np.isfinite(tests).all()):
        raise InputError("pose and test_pose: must be finite")
    space = space or guess_free_space(np.concatenate([pose, tests.reshape(-1, 3)])[:, :2])
    unknown = np.full((len(reading), 2), np.nan)  # only a simulation knows the angles of the wheels
    return Truth(pose, reading[:, :2], unknown, tests, space)


def guess_free_space(places: np.ndarray) -> FreeSpace:
    """The floor within ``FREE_RADIUS_M`` of places (N, 2) [m] as a map; raises InputError if they are too far apart."""
    low, high = places.min(axis=0) - 2 * FREE_RADIUS_M, places.max(axis=0) + 2 * FREE_RADIUS_M
    width_m, depth_m = high - low
    if width_m * depth_m > MAX_CELLS * CELL_M**2:
        raise InputError(
            f"pose: covers {width_m:g} x {depth_m:g} m, more than the {MAX_CELLS * CELL_M**2:g} m2 of which a map can "
            "be made; give free_space, or positions in metres"
        )
    x, y = (np.arange(first, last, CELL_M) for first, last in zip(low, high, strict=True))
    cells = np.stack(np.meshgrid(x, y), axis=-1)
    distance, _ = KDTree(places).query(cells.reshape(-1, 2), distance_upper_bound=FREE_RADIUS_M)
    free = np.isfinite(distance).reshape(cells.shape[:2])
    side_m = float(np.ptp(places, axis=0).min() + 2 * FREE_RADIUS_M)
    return FreeSpace(low, CELL_M, free, free.copy(), places[0], side_m)
