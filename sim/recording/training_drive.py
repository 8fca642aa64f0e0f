"""The training drive and its observations, shared by recordings that differ only in deployment or test grid."""

from pathlib import Path
from typing import Any

from sim.files.atomic import link_file
from sim.recording.format import OF_USE, name_source, read_manifest
from sim.recording.manifest import read_settings
from sim.settings import DeploymentSettings, GridSettings, SimSettings

OF_TESTS = ("test/", "truth/test_pose.npy", OF_USE)
"""Beginnings of the names of files that depend on deployment or test grid."""
COUNTED = (
    "samples",
    "segments",
    "readings",
    "readings_lost",
    "samples_dropped",
    "times_relocated",
    "distance_driven_m",
    "gl_renderer",
)
"""Entries of the manifest that tell of the training drive."""


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

    Raises:
        InputError: The recording's manifest cannot be read.
    """
    manifest = read_manifest(base)
    if manifest.seed != seed:
        return False
    other = read_settings(manifest)
    shared = can_share(other) and can_share(settings)
    return shared and keep_training_settings(other) == keep_training_settings(settings)


def link_training(base: Path, folder: Path) -> dict[str, Any]:
    """Link the files of a recording's training drive, or copy them where links are impossible.

    Returns:
        Their entries of the manifest.
    """
    manifest = read_manifest(base)
    for name in manifest.sha256:
        if not (name.startswith(OF_TESTS) or (folder / name).is_file()):
            link_file(base / name, folder / name)
    known = manifest.model_dump(by_alias=True, exclude_unset=True)
    return {name: known[name] for name in COUNTED if name in known} | {"derived_from": name_source(base)}
