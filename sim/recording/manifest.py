"""The manifest: a recording's metadata, checked once when it is opened; and the settings of its parts.

The deployment drive is a second drive of the same robot after training, with room and camera as they are then.
It is a recording of its own, in a folder inside the recording of the training drive; it has no test positions. The
light may change during the training drive.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sim.errors import InputError, one_line
from sim.files.checksums import FORMAT
from sim.rng import derive_seed
from sim.sensors.catalog import SENSORS, ObservationKind, list_kept
from sim.settings import (
    DeploymentImageFaultSettings,
    DeploymentMountSettings,
    DeploymentSettings,
    SimSettings,
    UntilSettings,
)

PACKAGES = ("mujoco", "numpy", "opencv-python-headless")  # Packages on whose versions the bytes of a recording depend
SENSOR = r"[a-z][a-z0-9_]{0,40}"  # Pattern of a sensor's name, which is part of the names of its files
DIMENSIONS: dict[ObservationKind, int] = {"polar_image": 4, "scan": 3, "vector": 2, "image": 3}
"""Axes of an array of observations, that of the observations included."""


class Manifest(BaseModel):
    """Metadata of a recording; a writer may add keys of its own."""

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True)

    number: int = Field(default=FORMAT, alias="format")  # Number of the format
    source: str = "simulator"  # Where it comes from: ``simulator``, or ``log`` of a robot
    # Kind of each sensor's observations, by its name; methods learn from the first
    sensors: dict[Annotated[str, Field(pattern=f"^{SENSOR}$")], ObservationKind] = Field(default_factory=dict)
    settings: dict[str, Any] = Field(default_factory=dict)  # Settings of the simulation, if there was one
    seed: int | None = None  # Seed of the simulation
    samples: int | None = None  # Number of observations of the first sensor
    segments: int | None = None  # Number of straight segments driven
    readings_lost: int = 0  # Number of encoder readings that never arrived
    distance_driven_m: float | None = None  # Distance travelled along all segments [m]
    # What is known of the wheels; ``sim.sensors.encoder.check_odometry`` checks it
    odometry: dict[str, Any] = Field(default_factory=dict)
    # Whether the readings were computed from an odometry, so that they tell nothing of the wheels
    wheels_computed: bool = False
    gl_renderer: str = "none"  # Name of the renderer of the images
    sha256: dict[str, str] = Field(default_factory=dict)  # Checksum of each file, by its path in the folder

    @property
    def start_ns(self) -> int:
        """When times of the recording count from [ns since 1970]; 0 unless it is of a robot's log."""
        log = (self.model_extra or {}).get("log", {})
        start_ns = log.get("start_ns", 0) if isinstance(log, dict) else 0
        return start_ns if isinstance(start_ns, int) else 0

    @property
    def sensor(self) -> str:
        """The sensor that methods learn from; empty if the manifest names none."""
        return next(iter(self.sensors), "")

    @property
    def kind(self) -> ObservationKind | None:
        """Kind of the observations that methods learn from; None if the manifest names no sensor."""
        return next(iter(self.sensors.values()), None)


def read_settings(manifest: Manifest) -> SimSettings:
    """The settings of a simulation by its manifest; raises InputError if they cannot be used."""
    try:
        return SimSettings.model_validate(manifest.settings)
    except ValidationError as error:
        raise InputError(f"manifest: {describe_problem(error, 'settings')}") from None


def describe_problem(error: ValidationError, *outer: str) -> str:
    """The first value that cannot be used, by its name after those of what it is in, and why."""
    problem = error.errors(include_url=False)[0]
    return f"{'.'.join(map(str, (*outer, *problem['loc'])))} cannot be used: {one_line(problem['msg'])}"


def name_sensors(settings: SimSettings) -> dict[str, ObservationKind]:
    """Sensors and their kinds for a simulation, as in a manifest."""
    return {name: SENSORS[name].kind for name in list_kept(settings)}


LIGHT_STATES = (
    DeploymentSettings(),
    DeploymentSettings(daylight=0.3),
    DeploymentSettings(daylight=1.0, lamps=0.0),
    DeploymentSettings(daylight=0.0),
)
"""Light of consecutive parts of the drive, in turn: as usual, little daylight, lamps off, night."""
DEPLOYMENT_FOLDER = "use"  # Folder of the deployment drive, in the recording's folder and in that of its parts
NO_TESTS = np.empty((0, 1, 3))  # Poses of the test positions of a recording without any


def light_part(settings: SimSettings, number: int) -> SimSettings:
    """Settings of what is sensed in the drive's part with a number: the drive's, with its light and its persons."""
    if not (settings.drive.mixed_light or settings.drive.person):
        return settings
    light = LIGHT_STATES[number % len(LIGHT_STATES)] if settings.drive.mixed_light else DeploymentSettings()
    seen = light.model_copy(update={"person": settings.drive.person})
    return settings.model_copy(update={"deployment": seen})


MAP_ENTRIES = ("unreached", "unseen")
"""What a robot with a map of its own tells at the end of the drive.

Floor that it saw and did not reach: places and areas [m, m, m2]; share of the floor that no image is near: likely, at
least, and at most.
"""


def set_deployment(settings: SimSettings) -> SimSettings:
    """Settings of all sensed in deployment: the room as ``deployment`` changes it, the camera as it is then."""
    none = {"camera_mount": DeploymentMountSettings(), "image_faults": DeploymentImageFaultSettings()}
    return settings.model_copy(
        update={
            "camera_mount": settings.camera_mount.override(settings.deployment.camera_mount),
            "image_faults": settings.image_faults.override(settings.deployment.image_faults),
            "deployment": settings.deployment.model_copy(update={"drive_samples": 0, **none}),
        }
    )


def choose_deployment(settings: SimSettings) -> SimSettings:
    """Settings of the deployment drive's recording: in the room and the light as ``deployment`` changes them."""
    drive = settings.drive.model_copy(
        update={
            "samples": settings.deployment.drive_samples,
            "mixed_light": False,
            "person": 0,
            "until": UntilSettings(),
        }
    )
    grid = settings.grid.model_copy(update={"held_out": 0})
    return set_deployment(settings).model_copy(update={"drive": drive, "grid": grid})


def seed_deployment(seed: int) -> int:
    """Seed of the deployment drive, by the seed of the training drive: all its RNG streams are its own."""
    return derive_seed(seed, DEPLOYMENT_FOLDER)
