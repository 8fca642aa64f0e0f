"""Settings of what changes between training and deployment."""

from typing import Literal

from pydantic import Field, field_validator

from sim.settings.drive import FEWEST_SAMPLES
from sim.settings.group import WithLater
from sim.settings.sensors import MountSettings


class DeploymentMountSettings(MountSettings):
    """How the camera is mounted in deployment, after it was knocked or mounted again; None: as in training."""

    roll_deg: float | None = Field(default=None, ge=-30.0, le=30.0)
    """The camera's axis leans to the robot's right by this [deg]; None: by camera_mount.roll_deg."""
    pitch_deg: float | None = Field(default=None, ge=-30.0, le=30.0)
    """The camera's axis leans forward by this [deg]; None: by camera_mount.pitch_deg."""
    ahead_m: float | None = Field(default=None, ge=-0.1, le=0.1)
    """The camera is ahead of the wheel axle by this [m]; None: by camera_mount.ahead_m."""
    left_m: float | None = Field(default=None, ge=-0.1, le=0.1)
    """The camera is to the left of the axle's middle by this [m]; None: by camera_mount.left_m."""
    centre_px: float | None = Field(default=None, ge=-50.0, le=50.0)
    """The optical centre is this far ahead of where it is assumed [px]; None: by camera_mount.centre_px."""


class DeploymentSettings(WithLater):
    """Changes between training and deployment: the test grid and the drive in use are made with them, the training
    drive is not."""

    later = frozenset({"daylight", "lamp_on", "exposure", "person"})

    drive_samples: int = Field(default=0, ge=0, le=100_000)
    """Images of a drive in use, a second drive of the same robot after training, in the changed room; 0: none,
    otherwise at least 16."""
    light: float = Field(default=1.0, ge=0.0, le=1.0)
    """All light, including that of windows, as a fraction of that in training; linear light, not pixel values."""
    lamps: float = Field(default=1.0, ge=0.0, le=1.0)
    """Light of the lamps alone, both what they emit and their own glow, as a fraction; ambient light stays."""
    daylight: float | None = Field(default=None, ge=0.0, le=4.0)
    """Light of the windows as a fraction of that in training. If set, the light of windows and of lamps is drawn apart,
    strongest near each, and mixed, the lamps' with the fraction lamps. None: windows are as in training."""
    lamp_on: bool = False
    """A lamp that was off in training hangs 2 m above a random free place and shines."""
    exposure: Literal["fixed", "auto"] = "fixed"
    """auto: the camera has automatic exposure and white balance, for each image by itself."""
    person: bool = False
    """In each image, a person stands at another random free place, without any effect on the physics."""
    moved_m: float = Field(default=0.0, ge=0.0, le=2.0)
    """Distance by which chairs and other small furniture have been pushed, each in a random feasible direction [m]."""
    camera_mount: DeploymentMountSettings = DeploymentMountSettings()

    @property
    def draws_sources_apart(self) -> bool:
        """Whether each kind of source is drawn apart and their light is mixed."""
        return self.daylight is not None or self.lamp_on

    @field_validator("drive_samples")
    @classmethod
    def _long_enough_for_a_drive(cls, samples: int) -> int:
        if 0 < samples < FEWEST_SAMPLES:
            raise ValueError(f"{samples} must be 0 or at least {FEWEST_SAMPLES}")
        return samples
