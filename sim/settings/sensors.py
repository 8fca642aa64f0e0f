"""Settings of what looks at the world: lidar, cameras, faults of image and mounting, and what changes in deployment."""

from typing import Literal

from pydantic import Field, field_validator

from sim.settings.group import Group
from sim.settings.world import FEWEST_SAMPLES

SensorName = Literal["fisheye", "lidar"]


class LidarSettings(Group):
    """The lidar: ordered distances all around the robot in one plane."""

    rays: int = Field(default=256, ge=8, le=4096)
    """Rays of one scan, evenly spaced, the first straight ahead."""
    headings: int = Field(default=1, ge=1, le=64)
    """Scans at each place, each turned from the last by 1 / headings of the angle between two rays. A turn by a full
    ray only shifts a scan circularly, so that training can draw any of rays x headings."""
    noise_m: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of each distance [m]."""


class CameraSettings(Group):
    """The upward fisheye camera."""

    height_m: float = Field(default=0.35, ge=0.2, le=1.5)
    """Height of the lens above the floor [m]."""
    field_of_view_deg: float = Field(default=190.0, ge=60.0, le=190.0)
    """Full angle of the image cone about the zenith [deg]."""
    k1: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Kannala-Brandt coefficient of theta^3; all four zero is the equidistant lens."""
    k2: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Kannala-Brandt coefficient of theta^5."""
    k3: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Kannala-Brandt coefficient of theta^7."""
    k4: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Kannala-Brandt coefficient of theta^9."""
    rings: int = Field(default=32, ge=4, le=256)
    """Rows of the polar image, from zenith to rim."""
    sectors: int = Field(default=128, ge=8, le=1024)
    """Columns of the polar image, once around."""
    face_px: int = Field(default=96, ge=16, le=512)
    """Side length of each rendered pinhole face [px]."""


class TagCameraSettings(Group):
    """A horizontal pinhole camera on the robot that sees tags, from which labels are made (Sec. IV-C)."""

    mounted: bool = False
    """Whether the robot has it; needs a room with tags, as room.kind lab or your own."""
    width_px: int = Field(default=960, ge=64, le=4096)
    """Columns of the image."""
    height_px: int = Field(default=540, ge=64, le=4096)
    """Rows of the image."""
    kept: bool = False
    """Whether the recording keeps its images, 0.5 MB each, in addition to the tags found in them."""


class ImageFaultSettings(Group):
    """Faults of the camera's sensor: they act on finished images, in training and in deployment."""

    exposure: float = Field(default=1.0, gt=0.0, le=16.0)
    """Exposure time, as a fraction of that of an image without faults; values brighter than white are cut off."""
    vignetting: float = Field(default=0.0, ge=0.0, le=0.99)
    """Fraction of the light that is lost at the rim of the image, decreasing to none in the middle."""
    read_noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of each sensor pixel's noise in the dark, as a fraction of white, in linear light."""
    shot_noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of each sensor pixel's photon noise at white, as a fraction of it; it grows with the root of
    the light. One over the root of the electrons that fill a pixel: 0.01 for 10,000 of them."""
    turn_deg: float = Field(default=0.0, ge=0.0, le=90.0)
    """Angle that the robot turns while the shutter is open, which smears each ring: turn rate x exposure time [deg]."""


class MountSettings(Group):
    """A mounting of the camera."""


class CameraMountSettings(MountSettings):
    """Faults of the camera's mounting and of its motion: they are rendered, in training and in deployment."""

    roll_deg: float = Field(default=0.0, ge=-30.0, le=30.0)
    """The camera's axis leans to the robot's right by this [deg]."""
    pitch_deg: float = Field(default=0.0, ge=-30.0, le=30.0)
    """The camera's axis leans forward by this [deg]."""
    wobble_deg: float = Field(default=0.0, ge=0.0, le=10.0)
    """Standard deviation of an additional random lean of each image, to the right and forward [deg]."""
    driven_m: float = Field(default=0.0, ge=0.0, le=0.5)
    """Distance that the robot drives while the shutter is open: speed x exposure time [m]."""
    ahead_m: float = Field(default=0.0, ge=-0.1, le=0.1)
    """The camera is ahead of the wheel axle by this [m]; positions remain those of the axle's middle."""
    left_m: float = Field(default=0.0, ge=-0.1, le=0.1)
    """The camera is to the left of the axle's middle by this [m]."""
    centre_px: float = Field(default=0.0, ge=-50.0, le=50.0)
    """The optical centre is this far ahead of where the unwrapping assumes it, for want of a calibration; pixels of a
    round image with a diameter of 480 [px]."""


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


class DeploymentSettings(Group):
    """Changes between training and deployment: the test grid and the drive in use are made with them, the training
    drive is not."""

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
