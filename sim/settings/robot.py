"""Settings of the robot: its body, wheel encoders and sensors, their faults, and what changes in deployment."""

from operator import not_
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from sim.errors import shorten
from sim.plugins import ENCODER_FAULTS
from sim.settings.group import Group
from sim.settings.world import MIN_SAMPLES, Persons

OWN_ROBOT_NAMES = ("left_joint", "right_joint", "camera_site")  # Settings that name parts of a user's own robot


class RobotSettings(Group):
    """The robot's body: a fault of its left wheel, or a robot of your own."""

    wheel_radius_error: float = Field(default=0.0, ge=-0.2, le=0.2)
    """The left wheel of the model itself is larger by this fraction, so the robot drives curves."""
    mjcf: str | None = Field(default=None, max_length=4096, pattern=r"^[^\x00]*$")
    """Your own robot: path of an MJCF file."""
    left_joint: str = "left_wheel"
    """Name of its left wheel's joint."""
    right_joint: str = "right_wheel"
    """Name of its right wheel's joint."""
    camera_site: str = "camera"
    """Name of the site of its camera, which looks along the site's z axis."""

    @model_serializer(mode="wrap")
    def _write_own_robot_only_if_there_is_one(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        own = ("mjcf", *OWN_ROBOT_NAMES)
        return {name: value for name, value in write(self).items() if name not in own or self.mjcf is not None}

    @model_validator(mode="after")
    def _only_our_wheel_can_be_scaled_and_only_an_own_robot_has_names(self) -> "RobotSettings":
        if self.mjcf is not None and self.wheel_radius_error:
            raise ValueError(f"wheel_radius_error {self.wheel_radius_error:g} must be 0 with a robot of your own")
        for name in OWN_ROBOT_NAMES if self.mjcf is None else ():
            if (value := getattr(self, name)) != RobotSettings.model_fields[name].default:
                raise ValueError(f"{name} {shorten(value)} names a part of a robot of your own, and needs mjcf")
        return self


class EncoderSettings(Group):
    """The wheel encoders and their faults; all but the first are faults of measurement."""

    ticks_per_rev: int = Field(default=4096, ge=4, le=65536)
    """Ticks per wheel revolution (TurtleBot3: 4096)."""
    radius_error_left: float = Field(default=0.0, ge=-0.2, le=0.2)
    """The left wheel's assumed radius is wrong by this fraction; its distances scale with 1 + the fraction."""
    radius_error_right: float = Field(default=0.0, ge=-0.2, le=0.2)
    """The right wheel's assumed radius is wrong by this fraction."""
    track_error: float = Field(default=0.0, ge=-0.5, le=0.5)
    """The assumed track width is wrong by this fraction (turns only)."""
    slip_per_m: float = Field(default=0.0, ge=0.0, le=0.5)
    """Standard deviation of each wheel's slip after a metre [m]; it grows with the root of the distance travelled."""
    step_noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """The paper's w: each gap between readings is multiplied by 1 + w n, n standard normal."""
    dropout: float = Field(default=0.0, ge=0.0, le=0.9)
    """Fraction of readings that never arrive."""
    stuck_fraction: float = Field(default=0.0, ge=0.0, le=0.9)
    """Fraction of the readings, in one stretch, during which one random encoder, left or right, counts nothing."""
    plugins: dict[str, float] = Field(default_factory=dict, exclude_if=lambda faults: not faults)
    """Strengths of the faults that plugins define, by name; a fault of strength 0 is left out."""

    def __hash__(self) -> int:
        return hash(self.model_dump_json())  # a dictionary has no hash

    @field_validator("plugins")
    @classmethod
    def _leave_out_what_is_off(cls, plugins: dict[str, float]) -> dict[str, float]:
        """A fault whose plugin is not loaded passes, since recordings with it can be read; driving refuses it."""
        for name, strength in plugins.items():
            low, high = ENCODER_FAULTS[name].limits if name in ENCODER_FAULTS else (-float("inf"), float("inf"))
            if strength and not low <= strength <= high:
                raise ValueError(f"{shorten(name)} {strength}: must be from {low:g} to {high:g}, or 0")
        return {name: plugins[name] for name in sorted(plugins) if plugins[name]}


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


Coefficient = Annotated[float, Field(ge=-0.5, le=0.5)]


class CameraSettings(Group):
    """The upward fisheye camera."""

    height_m: float = Field(default=0.35, ge=0.2, le=1.5)
    """Height of the lens above the floor [m]."""
    field_of_view_deg: float = Field(default=190.0, ge=60.0, le=190.0)
    """Full angle of the image cone about the zenith [deg]."""
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient] = (0.0, 0.0, 0.0, 0.0)
    """Kannala-Brandt coefficients k1 to k4, of theta^3 to theta^9; all zero is the equidistant lens."""
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
    """Faults of the image, in training and in deployment. Glare and JPEG are rendered, in the round image before it is
    unwrapped; the others act on finished images."""

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
    hidden_deg: float = Field(default=0.0, ge=0.0, le=180.0, exclude_if=not_)
    """Angle behind the robot in which a mast hides the view, from the rim to the zenith [deg]."""
    glare: float = Field(default=0.0, ge=0.0, le=1.0, exclude_if=not_)
    """Fraction of the light of lamps and windows that the lens scatters, close to them and over the image."""
    jpeg_kb: float = Field(default=0.0, ge=0.0, le=1000.0, exclude_if=not_)
    """Largest size of a round image of 480 x 480 pixels as a JPEG file [kB]; 0: it is not compressed."""


class DeploymentImageFaultSettings(Group):
    """Faults of the image in deployment; None: as in training."""

    read_noise: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard deviation of each sensor pixel's noise in the dark, of white; None: by image_faults.read_noise."""
    hidden_deg: float | None = Field(default=None, ge=0.0, le=180.0)
    """Angle behind the robot in which a mast hides the view [deg]; None: by image_faults.hidden_deg."""
    glare: float | None = Field(default=None, ge=0.0, le=1.0)
    """Fraction of the light of lamps and windows that the lens scatters; None: by image_faults.glare."""
    jpeg_kb: float | None = Field(default=None, ge=0.0, le=1000.0)
    """Largest size of a round image as a JPEG file [kB]; None: by image_faults.jpeg_kb."""


class CameraMountSettings(Group):
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


class DeploymentMountSettings(Group):
    """How the camera is mounted in deployment, after it was knocked or mounted again; None: as in training."""

    roll_deg: float | None = Field(default=None, ge=-30.0, le=30.0)
    """The camera's axis leans to the robot's right by this [deg]; None: by camera_mount.roll_deg."""
    pitch_deg: float | None = Field(default=None, ge=-30.0, le=30.0)
    """The camera's axis leans forward by this [deg]; None: by camera_mount.pitch_deg."""
    wobble_deg: float | None = Field(default=None, ge=0.0, le=10.0, exclude_if=lambda wobble_deg: wobble_deg is None)
    """Standard deviation of an additional random lean of each image [deg]; None: by camera_mount.wobble_deg."""
    ahead_m: float | None = Field(default=None, ge=-0.1, le=0.1)
    """The camera is ahead of the wheel axle by this [m]; None: by camera_mount.ahead_m."""
    left_m: float | None = Field(default=None, ge=-0.1, le=0.1)
    """The camera is to the left of the axle's middle by this [m]; None: by camera_mount.left_m."""
    centre_px: float | None = Field(default=None, ge=-50.0, le=50.0)
    """The optical centre is this far ahead of where it is assumed [px]; None: by camera_mount.centre_px."""


class DeploymentSettings(Group):
    """Changes between training and deployment: the test grid and the deployment drive are made with them, the training
    drive is not."""

    drive_samples: int = Field(default=0, ge=0, le=100_000)
    """Images of a deployment drive, a second drive of the same robot after training, in the changed room; 0: none,
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
    person: Persons = 0
    """Persons in view, at most 3 (true: 1), without any effect on the physics. On a drive they walk and stand; in each
    image of the test grid they stand at other random free places."""
    moved_m: float = Field(default=0.0, ge=0.0, le=2.0)
    """Distance by which chairs and other small furniture have been pushed, each in a random feasible direction [m]."""
    camera_mount: DeploymentMountSettings = DeploymentMountSettings()
    image_faults: DeploymentImageFaultSettings = Field(
        default=DeploymentImageFaultSettings(), exclude_if=lambda faults: faults == DeploymentImageFaultSettings()
    )

    @property
    def draws_sources_apart(self) -> bool:
        """Whether each kind of source is drawn apart and their light is mixed."""
        return self.daylight is not None or self.lamp_on

    @field_validator("drive_samples")
    @classmethod
    def _long_enough_for_a_drive(cls, samples: int) -> int:
        if 0 < samples < MIN_SAMPLES:
            raise ValueError(f"{samples} must be 0 or at least {MIN_SAMPLES}")
        return samples
