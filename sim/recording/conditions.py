"""Conditions of what is sensed: light that changes during the training drive, and the drive in use.

The drive in use is a second drive of the same robot after training, in the room and with the camera as they are then.
It is a recording of its own, in a folder inside the recording of the training drive; it has no test positions.
"""

import numpy as np

from sim.rng import derive_seed
from sim.settings import DeploymentMountSettings, DeploymentSettings, SimSettings

STATES = (
    DeploymentSettings(),
    DeploymentSettings(daylight=0.3),
    DeploymentSettings(daylight=1.0, lamps=0.0),
    DeploymentSettings(daylight=0.0),
)
"""Light of consecutive parts of the drive, in turn: as usual, little daylight, lamps off, night."""
FOLDER = "use"
"""Folder of the drive in use, in the recording's folder and in that of its parts."""
NO_TESTS = np.empty((0, 1, 3))
"""Poses of the test positions of a recording without any."""


def light_part(settings: SimSettings, number: int) -> SimSettings:
    """Settings of what is sensed in the drive's part with a number, which are the drive's if the light is constant."""
    if not settings.drive.mixed_light:
        return settings
    return settings.model_copy(update={"deployment": STATES[number % len(STATES)]})


def set_in_use(settings: SimSettings) -> SimSettings:
    """Settings of all that is sensed in use: the room as ``deployment`` changes it, the camera as it leans then."""
    leans = {name: value for name, value in settings.deployment.camera_mount if value is not None}
    changes = {"drive_samples": 0, "camera_mount": DeploymentMountSettings()}
    return settings.model_copy(
        update={
            "camera_mount": settings.camera_mount.model_copy(update=leans),
            "deployment": settings.deployment.model_copy(update=changes),
        }
    )


def choose_drive_in_use(settings: SimSettings) -> SimSettings:
    """Settings of the recording of the drive in use: in the room as ``deployment`` changes it, in the light of use."""
    drive = settings.drive.model_copy(update={"samples": settings.deployment.drive_samples, "mixed_light": False})
    grid = settings.grid.model_copy(update={"held_out": 0})
    return set_in_use(settings).model_copy(update={"drive": drive, "grid": grid})


def seed_in_use(seed: int) -> int:
    """Seed of the drive in use, by the seed of the training drive: all its RNG streams are its own."""
    return derive_seed(seed, FOLDER)
