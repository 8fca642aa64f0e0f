"""Assembly of a recording's files from the chunks of its drive and the image files next to them."""

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sim.apriltag.bundle_adjustment import write_labels
from sim.apriltag.detector import Detections
from sim.errors import DamagedError
from sim.files.checksums import read_arrays, write_array, write_blocks
from sim.geometry import planar_pose
from sim.recording.chunks import DIFFERENCES, IMAGE, RENDERER, REPEATS, part_files
from sim.recording.format import grid_file, measure_driven, observation_file, stamp, time_file, turn_file
from sim.recording.manifest import MAP_ENTRIES
from sim.recording.turns import FILE as TURNS
from sim.recording.turns import count_images, list_turns, lose_turns
from sim.sensors.camera.tag_camera import NAME, camera_matrix, mounting
from sim.sensors.catalog import SENSORS, Measure, Measures, list_kept, load
from sim.sensors.encoder import read_encoders
from sim.settings import SimSettings

SERIES = ("state", "segment", "observation", "wheel_angle", "time", "turn_kind")
log = logging.getLogger(__name__)


class CollectedDrive(NamedTuple):
    """The chunks of a drive in order, the file for each chunk's images, and those for images after turns, if any.

    A chunk holds ``state`` (n, nq) for its new observations, and for its readings ``segment`` (r,), ``observation``
    (r,), both numbered over the complete drive, ``wheel_angle`` (r, 2) [rad] and ``time`` (r,) [s]; for its segments,
    ``turn_kind`` (s,) of the turn before each, and ``turn_state`` (t, nq) after turns in place.
    """

    chunks: list[dict[str, np.ndarray]]
    images: list[Path]
    turns: list[Path]


def write_drive(
    folder: Path, settings: SimSettings, drive: CollectedDrive, rng: np.random.Generator, wheel_radius_m: float
) -> dict[str, Any]:
    """Write the drive, cut to the number of samples wanted, and return its entries for the manifest.

    The wheel radius is the effective one [m]; ``rng`` is the parent of the RNG streams of the encoders' faults.
    """
    samples = settings.drive.samples
    joined = {
        name: np.concatenate([chunk[name] for chunk in drive.chunks]) for name in drive.chunks[0] if name in SERIES
    }
    kept = joined["observation"] < samples
    segment, angle = joined["segment"][kept], joined["wheel_angle"][kept]
    ticks, arrived = read_encoders(angle, wheel_radius_m, settings.encoder, rng)
    reading = np.column_stack([segment, joined["observation"][kept], ticks]).astype(np.int64)
    state = joined["state"][:samples]
    for sensor in list_kept(settings):  # all observe at the same time
        write_array(folder / time_file(sensor), stamp(reading[:, 1], joined["time"][kept], samples))
    write_array(folder / "reading.npy", reading[arrived])
    if settings.drive.turn_images:
        turns = lose_turns(list_turns(segment, reading[:, 1], joined["turn_kind"]), segment, arrived)
        write_array(folder / TURNS, turns.array)
    write_array(folder / "time.npy", joined["time"][kept][arrived])
    write_array(folder / "truth" / "reading.npy", reading[:, :2])
    write_array(folder / "truth" / "wheel_angle.npy", angle)
    write_array(folder / "truth" / "state.npy", state)
    write_array(folder / "truth" / "pose.npy", planar_pose(state))
    return {
        "samples": samples,
        "segments": int(segment[-1]) + 1,
        "readings": len(reading),
        "readings_lost": int((~arrived).sum()),
        "samples_dropped": int(sum(chunk["dropped"] for chunk in drive.chunks)),
        "times_relocated": int(sum(chunk.get("relocated", 0) for chunk in drive.chunks)),
        "distance_driven_m": measure_driven(segment, angle.mean(axis=1) * wheel_radius_m),
        **{name: drive.chunks[-1][name].round(4).tolist() for name in MAP_ENTRIES if name in drive.chunks[-1]},
    }


def cut_short(settings: SimSettings, drive: CollectedDrive) -> SimSettings:
    """The settings with as many samples as were driven, where the drive was done before."""
    driven = int(drive.chunks[-1]["observations"]) if drive.chunks else settings.drive.samples
    if driven >= settings.drive.samples:
        return settings
    return settings.model_copy(update={"drive": settings.drive.model_copy(update={"samples": driven})})


def take_held_out(settings: SimSettings, drive: CollectedDrive) -> np.ndarray:
    """Poses (C, 1, 3) of the held-out test samples, which were driven after the training samples."""
    samples = settings.drive.samples
    state = np.concatenate([chunk["state"] for chunk in drive.chunks])[samples : samples + settings.grid.held_out]
    return planar_pose(state)[:, None]


def write_observations(folder: Path, settings: SimSettings, seed: int, drive: CollectedDrive) -> None:
    """Write the observations of the drive by all sensors that are kept, as each measures them."""
    samples = settings.drive.samples
    images = _count_turn_images(drive, samples)
    for name in list_kept(settings):
        measures = _make_measures(name, settings, seed)
        seen, turned = ([part_files(settings, path)[name] for path in parts] for parts in (drive.images, drive.turns))
        write_images(folder / observation_file(name), seen, (samples,), measure=measures.drive)
        if settings.drive.turn_images:
            write_images(folder / turn_file(name), turned or seen, (images,), measure=measures.turn)


def write_tests(folder: Path, settings: SimSettings, seed: int, tests: Sequence[Path], shape: tuple[int, ...]) -> None:
    """Write the observations at the test positions, of leading shape (C, H), from the files of their parts.

    Held-out test samples are in the parts of the drive, after its samples.
    """
    first = settings.drive.samples if settings.grid.held_out else 0
    for name in list_kept(settings):
        seen = [part_files(settings, path)[name] for path in tests]
        write_images(folder / grid_file(name), seen, shape, first, _make_measures(name, settings, seed).test)


def _make_measures(sensor: str, settings: SimSettings, seed: int) -> Measures:
    make_measures = SENSORS[sensor].make_measures
    return load(make_measures)(settings, seed) if make_measures else Measures()


def _count_turn_images(drive: CollectedDrive, samples: int) -> int:
    """Number of turns in place before a segment whose first reading is within so many samples."""
    segment, observation, kind = (
        np.concatenate([chunk[name] for chunk in drive.chunks]) for name in ("segment", "observation", "turn_kind")
    )
    kept = observation < samples
    return count_images(list_turns(segment[kept], observation[kept], kind))


def write_tag_labels(
    folder: Path, settings: SimSettings, images: Sequence[Path], tests: Sequence[Path], test_shape: tuple[int, ...]
) -> dict[str, int]:
    """Write labels from the tags that ``sense_part`` found in images; returns their manifest entries."""
    samples, held_out = settings.drive.samples, settings.grid.held_out
    seen, test_seen = (_join_detections(settings, parts) for parts in (images, tests))
    seen, first = seen.of(seen.view < samples), samples if held_out else 0
    test_seen = Detections(test_seen.view - first, test_seen.tag, test_seen.corner)
    inside = (test_seen.view >= 0) & (test_seen.view < np.prod(test_shape))
    camera, mount = camera_matrix(settings.tag_camera), mounting()
    return write_labels(folder, seen, test_seen.of(inside), (samples, *test_shape), camera, mount)


def write_images(
    path: Path, parts: Sequence[Path], shape: tuple[int, ...], first: int = 0, measure: Measure | None = None
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
            yield measure(kept) if measure else kept

    write_blocks(path, (*shape, *some.shape[1:]), some.dtype, take())


def count_drawn(settings: SimSettings, parts: Sequence[Path]) -> dict[str, Any]:
    """Manifest entries on the renderer: its name, how many images it drew twice and how many differed."""
    counts = {"gl_renderer": "none", "images_drawn_twice": 0, "images_that_differed": 0}
    for path in parts:
        stored = [read_part(file) for file in part_files(settings, path).values()]
        counts["gl_renderer"] = stored[0][RENDERER].item()  # of the sensor from which methods learn
        counts["images_drawn_twice"] += sum(int(one[REPEATS]) for one in stored)
        counts["images_that_differed"] += sum(int(one[DIFFERENCES]) for one in stored)
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


def read_if_whole(path: Path) -> dict[str, np.ndarray] | None:
    """Read a file of an unfinished recording, if it exists and is intact; a damaged file is removed."""
    with suppress(DamagedError):
        return read_part(path)
    return None


def _join_detections(settings: SimSettings, parts: Sequence[Path]) -> Detections:
    """Join the detections of image files, with views numbered over all files."""
    found, before = [], 0
    for path in parts:
        stored = read_part(part_files(settings, path)[NAME])
        found.append((stored["view"] + before, stored["tag"], stored["corner"]))
        before += len(read_part(path)[IMAGE])
    return Detections(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))
