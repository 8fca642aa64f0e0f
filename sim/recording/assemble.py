"""Assembly of a recording's files from the chunks of its drive and the image files next to them."""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sim.apriltag.detector import Detections
from sim.apriltag.labels import write_labels
from sim.errors import DamagedError
from sim.files import link_file, read_arrays, write_array, write_blocks
from sim.geometry import planar_pose
from sim.recording.format import grid_file, observation_file, stamp, time_file
from sim.recording.manifest import name_sensors
from sim.recording.sensing import DETECTIONS, DIFFERED, IMAGE, RENDERER, TAG_CAMERA, TWICE
from sim.rng import stream
from sim.robot.model import WHEEL_RADIUS_M
from sim.sensors.camera_faults import make_develop, spawn_streams
from sim.sensors.encoder import read_encoders, ticks_to_distance
from sim.sensors.lidar_scan import measure
from sim.sensors.tag_camera import camera_matrix, mounting
from sim.settings import SimSettings

JOINED = ("state", "segment", "observation", "wheel_angle", "time")
Sense = Callable[[np.ndarray], np.ndarray]
"""Turns ideal images or scans into those that the sensor reports."""
log = logging.getLogger(__name__)


class Drive(NamedTuple):
    """The chunks of a drive in order, and the file for each chunk's images.

    A chunk holds ``state`` (n, nq) for its new observations, and for its readings ``segment`` (r,), ``observation``
    (r,), both numbered over the complete drive, ``wheel_angle`` (r, 2) [rad] and ``time`` (r,) [s].
    """

    chunks: list[dict[str, np.ndarray]]
    images: list[Path]


def make_senses(settings: SimSettings, seed: int) -> tuple[Sense | None, Sense | None]:
    """Return the sensor's transformations of ideal data: for the drive and for the tests."""
    if settings.sensor == "lidar":
        noise = stream(seed, "lidar")

        def scan(scans: np.ndarray) -> np.ndarray:
            return measure(scans, settings.lidar, noise)

        return scan, scan
    chance = spawn_streams(seed)
    return make_develop(settings.image_faults, chance.noise), make_develop(settings.image_faults, chance.test_noise)


def write_drive(
    folder: Path, settings: SimSettings, drive: Drive, rng: np.random.Generator, sense: Sense | None = None
) -> dict[str, float]:
    """Write the drive, cut to the number of samples wanted, and return its entries for the manifest."""
    samples = settings.drive.samples
    joined = {
        name: np.concatenate([chunk[name] for chunk in drive.chunks]) for name in drive.chunks[0] if name in JOINED
    }
    kept = joined["observation"] < samples
    segment, angle = joined["segment"][kept], joined["wheel_angle"][kept]
    ticks, arrived = read_encoders(angle, WHEEL_RADIUS_M, settings.encoder, rng)
    reading = np.column_stack([segment, joined["observation"][kept], ticks]).astype(np.int64)
    state = joined["state"][:samples]
    sensor, *_ = name_sensors(settings)
    write_images(folder / observation_file(sensor), drive.images, (samples,), sense=sense)
    write_array(folder / time_file(sensor), stamp(reading[:, 1], joined["time"][kept], samples))
    write_array(folder / "reading.npy", reading[arrived])
    write_array(folder / "time.npy", joined["time"][kept][arrived])
    write_array(folder / "truth" / "reading.npy", reading[:, :2])
    write_array(folder / "truth" / "wheel_angle.npy", angle)
    write_array(folder / "truth" / "state.npy", state)
    write_array(folder / "truth" / "pose.npy", planar_pose(state))
    travelled_m = ticks_to_distance(angle, WHEEL_RADIUS_M, 1).mean(axis=1) / (2 * np.pi)
    driven = np.diff(travelled_m)[np.diff(segment) == 0]
    return {
        "samples": samples,
        "segments": int(segment[-1]) + 1,
        "readings": len(reading),
        "readings_lost": int((~arrived).sum()),
        "samples_dropped": int(sum(chunk["dropped"] for chunk in drive.chunks)),
        "times_relocated": int(sum(chunk.get("relocated", 0) for chunk in drive.chunks)),
        "distance_driven_m": round(float(np.abs(driven).sum()), 3),
    }


def take_held_out(settings: SimSettings, drive: Drive) -> np.ndarray:
    """Poses (C, 1, 3) of the held-out test samples, which were driven after the training samples."""
    samples = settings.drive.samples
    state = np.concatenate([chunk["state"] for chunk in drive.chunks])[samples : samples + settings.grid.held_out]
    return planar_pose(state)[:, None]


def write_tag_camera(
    folder: Path, settings: SimSettings, images: Sequence[Path], tests: Sequence[Path], test_shape: tuple[int, ...]
) -> dict[str, int]:
    """Write labels from the tag camera's detections and, if kept, its images; returns their manifest entries.

    ``sense_part`` has left both next to ``images`` and ``tests``.
    """
    samples, held_out = settings.drive.samples, settings.grid.held_out
    seen, test_seen = (_join_detections(parts) for parts in (images, tests))
    seen, first = seen.of(seen.view < samples), samples if held_out else 0
    test_seen = Detections(test_seen.view - first, test_seen.tag, test_seen.corner)
    inside = (test_seen.view >= 0) & (test_seen.view < np.prod(test_shape))
    camera, mount = camera_matrix(settings.tag_camera), mounting(settings.tag_camera)
    if settings.tag_camera.kept:
        ahead = [[path.with_suffix(TAG_CAMERA) for path in parts] for parts in (images, tests)]
        write_images(folder / observation_file("tag_camera"), ahead[0], (samples,))
        link_file(folder / time_file("fisheye"), folder / time_file("tag_camera"))  # both expose at the same time
        write_images(folder / grid_file("tag_camera"), ahead[1], test_shape, first)
    return write_labels(folder, seen, test_seen.of(inside), (samples, *test_shape), camera, mount)


def write_images(
    path: Path, parts: Sequence[Path], shape: tuple[int, ...], first: int = 0, sense: Sense | None = None
) -> None:
    """Join image files, from image ``first`` on, into one array of this leading shape; drop the rest."""

    count = math.prod(shape)
    some = read_part(parts[0])[IMAGE]

    def take() -> Iterator[np.ndarray]:
        written, skipped = 0, first
        for part in parts:
            images = read_part(part)[IMAGE]
            kept = images[skipped:][: count - written]
            written, skipped = written + len(kept), max(skipped - len(images), 0)
            yield sense(kept) if sense else kept

    write_blocks(path, (*shape, *some.shape[1:]), some.dtype, take())


def count_drawn(parts: Sequence[Path]) -> dict[str, Any]:
    """Manifest entries on the renderer: its name, how many images it drew twice and how many differed."""
    counts = {"gl_renderer": "none", "images_drawn_twice": 0, "images_that_differed": 0}
    for path in parts:
        part = read_part(path)
        counts["gl_renderer"] = part[RENDERER].item()
        beside = path.with_suffix(DETECTIONS)
        for stored in [part, read_part(beside)] if beside.is_file() else [part]:
            counts["images_drawn_twice"] += int(stored[TWICE])
            counts["images_that_differed"] += int(stored[DIFFERED])
    return counts


def read_part(path: Path) -> dict[str, np.ndarray]:
    """Read a file of an unfinished recording; if it is damaged, remove it and raise DamagedError."""
    if not path.is_file():
        raise DamagedError(f"{path} is missing")
    try:
        return read_arrays(path)
    except DamagedError as error:
        log.warning("%s; it is made again", error)
        path.unlink()
        raise


def _join_detections(parts: Sequence[Path]) -> Detections:
    """Join the detections of image files, with views numbered over all files."""
    found, before = [], 0
    for path in parts:
        stored = read_part(path.with_suffix(DETECTIONS))
        found.append((stored["view"] + before, stored["tag"], stored["corner"]))
        before += len(read_part(path)[IMAGE])
    return Detections(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))
