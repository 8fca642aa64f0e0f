"""Derivation of a recording from another one of the same drive, without driving or rendering again.

Recordings whose settings differ only in the encoder share the drive and its images; only the ticks are computed again
from the wheel angles. If they differ in faults of finished images, these are applied to the other's images. And a drive
does not depend on its length: a shorter one is the beginning of a longer one.

Recordings that differ in deployment or test grid alone share the training drive and its observations.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from sim.errors import InputError
from sim.files.atomic import link_file
from sim.files.checksums import write_array, write_blocks
from sim.recording.format import (
    DEPLOYMENT_MANIFEST,
    Recording,
    Truth,
    finish_recording,
    grid_file,
    measure_driven,
    name_source,
    observation_file,
    open_recording,
    open_truth,
    read_manifest,
    remove_recording,
    turn_file,
)
from sim.recording.manifest import (
    DEPLOYMENT_FOLDER,
    MAP_ENTRIES,
    Manifest,
    choose_deployment,
    read_settings,
    seed_deployment,
)
from sim.recording.turns import FILE as TURNS
from sim.recording.turns import Turns, count_images, cut_turns, lose_turns
from sim.rng import stream
from sim.sensors.camera.faults import drop_faults, make_measures
from sim.sensors.catalog import Measure
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import DeploymentSettings, EncoderSettings, GridSettings, SimSettings

SAMPLE_FILES = ("truth/pose.npy", "truth/state.npy")
OBSERVATION_PREFIX = "observations/"
READING_FILES = ("truth/reading.npy", "truth/wheel_angle.npy")
ENCODER_FILES = ("reading.npy", "time.npy", TURNS)  # Files that depend on the encoder settings
TEST_PREFIXES = ("test/", "truth/test_pose.npy", DEPLOYMENT_MANIFEST)
"""Beginnings of the names of files that depend on deployment or test grid."""
TRAINING_ENTRIES = (
    "samples",
    "segments",
    "readings",
    "readings_lost",
    "samples_dropped",
    "times_relocated",
    *MAP_ENTRIES,
    "distance_driven_m",
    "gl_renderer",
)
"""Entries of the manifest that tell of the training drive."""
IMAGE_COUNTS = ("images_drawn_twice", "images_that_differed")
DEPLOYMENT_SAMPLES = "deployment.drive_samples"
BATCH_SIZE = 256  # Images that are processed at a time


def choose_drive(settings: SimSettings, samples: int) -> SimSettings:
    """Settings of the recording of so many samples from which others of the same drive are derived: without faults,
    unless these decide when it ends."""
    settings = settings.model_copy(update={"drive": settings.drive.model_copy(update={"samples": samples})})
    if settings.drive.until.radius_m is not None:
        return settings
    return drop_faults(settings.model_copy(update={"encoder": EncoderSettings()}))


def can_be_cut(settings: SimSettings) -> bool:
    """Whether a shorter recording is the beginning of this one; held-out tests, tags, lidar noise or what is learned
    while driving prevent that."""
    learns = settings.drive.until.radius_m is not None
    return not (settings.grid.held_out or settings.tag_camera.mounted or settings.lidar.noise_m or learns)


def derive(base: Path, settings: SimSettings, seed: int, folder: Path) -> None:
    """Derive a recording from another one of the same drive, byte for byte as if it had been collected.

    Unchanged files are hard links, or copies where links are impossible: each recording is complete without the other.
    The other one is not shorter, has lost no readings, and its images have no faults; its settings and seed are the
    same, except for the encoder, faults of the finished image and the number of samples; if not, InputError is raised.
    """
    if (folder / "manifest.json").is_file():
        return
    start = time.perf_counter()
    recording, truth = open_recording(base), open_truth(base)
    if misfit := explain_misfit(base, settings, seed):
        raise InputError(f"{base} {misfit}")
    remove_recording(folder)  # remove what a killed process left
    if settings.deployment.drive_samples:
        derive(base / DEPLOYMENT_FOLDER, choose_deployment(settings), seed_deployment(seed), folder / DEPLOYMENT_FOLDER)
    samples = min(settings.drive.samples, len(truth.pose))
    kept = int((truth.reading[:, 1] < samples).sum())  # observations are numbered as they were made
    whole = samples == len(truth.pose)
    turns = None if recording.turns is None else cut_turns(recording.turns, kept)
    measures = make_measures(settings, seed)
    faults = {
        observation_file("fisheye"): measures.drive,
        grid_file("fisheye"): measures.test,
        turn_file("fisheye"): measures.turn,
    }
    for name in recording.manifest.sha256:
        length = _cut(name, recording.manifest, samples, kept, turns)
        if fault := faults.get(name):
            _develop_again(base / name, folder / name, fault, length)
        elif length is not None and not whole:
            array = np.load(base / name, mmap_mode="r", allow_pickle=False)
            write_array(folder / name, array[:length])
        elif name not in (*ENCODER_FILES, DEPLOYMENT_MANIFEST):
            link_file(base / name, folder / name)
    manifest = recording.manifest.model_dump(by_alias=True, exclude_unset=True)
    if not whole:
        for name in ("samples_dropped", "times_relocated", *MAP_ENTRIES, *IMAGE_COUNTS):  # of the complete drive
            manifest.pop(name, None)
    manifest |= _read_again(recording, truth, turns, kept, settings, seed, folder)
    manifest |= {"settings": settings.model_dump(mode="json"), "samples": samples}
    manifest |= {"derived_from": name_source(base), "collect_s": round(time.perf_counter() - start, 2)}
    finish_recording(folder, manifest)


def _cut(name: str, manifest: Manifest, samples: int, readings: int, turns: Turns | None) -> int | None:
    """Rows of a file in a drive of so many samples and readings; None: it does not depend on the drive's length."""
    if turns is not None and name in map(turn_file, manifest.sensors):
        return count_images(turns)
    if name in SAMPLE_FILES or name.startswith(OBSERVATION_PREFIX):
        return samples
    return readings if name in READING_FILES else None


def _read_again(
    recording: Recording,
    truth: Truth,
    turns: Turns | None,
    kept: int,
    settings: SimSettings,
    seed: int,
    folder: Path,
) -> dict[str, Any]:
    """Write the first readings of a drive as these encoders measure them; returns their manifest entries."""
    odometry, encoder = recording.manifest.odometry, settings.encoder
    number, angle = truth.reading[:kept], truth.wheel_angle[:kept]
    ticks, arrived = read_encoders(angle, odometry["wheel_radius_m"], encoder, stream(seed, "encoder"))
    write_array(folder / "reading.npy", np.column_stack([number, ticks]).astype(np.int64)[arrived])
    write_array(folder / "time.npy", recording.time[:kept][arrived])
    if turns is not None:
        write_array(folder / TURNS, lose_turns(turns, number[:, 0], arrived).array)
    track_m = odometry["track_m"] / (1.0 + recording.manifest.settings["encoder"]["track_error"])
    return {
        "segments": int(number[-1, 0]) + 1,
        "readings": kept,
        "readings_lost": int((~arrived).sum()),
        "distance_driven_m": measure_driven(number[:, 0], angle.mean(axis=1) * odometry["wheel_radius_m"]),
        "odometry": describe_odometry(encoder, odometry["wheel_radius_m"], track_m),
    }


def explain_misfit(base: Path, settings: SimSettings, seed: int) -> str | None:
    """Why no recording with these settings and this seed can be derived from that in a folder; None: it can.

    Raises InputError if the manifest of the recording, or of its deployment drive, cannot be read.
    """
    manifest = read_manifest(base)
    if misfit := _explain_misfit_of_drive(manifest, settings, seed):
        return misfit
    if not settings.deployment.drive_samples:
        return None
    if DEPLOYMENT_MANIFEST not in manifest.sha256:
        return f"has no deployment drive, and deployment.drive_samples is {settings.deployment.drive_samples}"
    inner = read_manifest(base / DEPLOYMENT_FOLDER)
    misfit = _explain_misfit_of_drive(inner, choose_deployment(settings), seed_deployment(seed), DEPLOYMENT_SAMPLES)
    return misfit and f"has a deployment drive that {misfit}"


def _explain_misfit_of_drive(
    manifest: Manifest, settings: SimSettings, seed: int, title: str = "drive.samples"
) -> str | None:
    """The same for a recording without its deployment drive, whose length is called ``title``."""
    samples, other = settings.drive.samples, read_settings(manifest)
    length = other.drive.samples
    reasons = {
        "is a recording of another drive: only encoder.*, image_faults.* and drive.samples may differ": (
            (_strip(other, samples), manifest.seed) != (_strip(settings, samples), seed)
        ),
        "has faults in its images, which cannot be taken away: nothing can be derived from it": (
            other != drop_faults(other)
        ),
        f"has {length} samples, too few for {title} {samples}": length < samples,
        f"has {length} samples, of which {samples} are no recording of their own": (
            length > samples and not can_be_cut(settings)
        ),
        "has lost readings, whose times are not known: nothing can be derived from it": manifest.readings_lost > 0,
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def _strip(settings: SimSettings, samples: int) -> SimSettings:
    """Settings without what may differ between a recording and one derived from it."""
    drive = choose_drive(settings, samples)
    return drive.model_copy(update={"deployment": drive.deployment.model_copy(update={"drive_samples": 0})})


def _develop_again(source: Path, target: Path, fault: Measure, count: int | None) -> None:
    """Write the images of a file, or the first ``count``, with faults, in blocks."""
    images = np.load(source, mmap_mode="r", allow_pickle=False)[:count]
    flat = images.reshape(-1, *images.shape[-3:])
    blocks = (fault(np.asarray(flat[first : first + BATCH_SIZE])) for first in range(0, len(flat), BATCH_SIZE))
    write_blocks(target, images.shape, images.dtype, blocks)


def keep_training_settings(settings: SimSettings) -> SimSettings:
    """The settings without deployment and test grid, which do not affect the training drive."""
    return settings.model_copy(update={"deployment": DeploymentSettings(), "grid": GridSettings()})


def can_share(settings: SimSettings) -> bool:
    """Whether recordings of these settings can share a training drive at all.

    Held-out tests are driven after it, and labels from tags are fitted to training and test images together.
    """
    return settings.world == "room" and not (settings.grid.held_out or settings.tag_camera.mounted)


def has_same_training_drive(base: Path, settings: SimSettings, seed: int) -> bool:
    """Whether the training drive of a recording has the bytes that these settings and this seed would give.

    Raises InputError if the recording's manifest cannot be read.
    """
    manifest = read_manifest(base)
    if manifest.seed != seed:
        return False
    other = read_settings(manifest)
    shared = can_share(other) and can_share(settings)
    return shared and keep_training_settings(other) == keep_training_settings(settings)


def link_training(base: Path, folder: Path) -> dict[str, Any]:
    """Link the files of a recording's training drive, or copy them; return their entries of the manifest."""
    manifest = read_manifest(base)
    for name in manifest.sha256:
        if not (name.startswith(TEST_PREFIXES) or (folder / name).is_file()):
            link_file(base / name, folder / name)
    known = manifest.model_dump(by_alias=True, exclude_unset=True)
    return {name: known[name] for name in TRAINING_ENTRIES if name in known} | {"derived_from": name_source(base)}
