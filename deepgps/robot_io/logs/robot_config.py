"""What a log does not say of its robot: ``robot.yaml``, checked at once."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from deepgps.config.plain_yaml import read_yaml
from deepgps.config.setting_problems import describe_problems
from sim.errors import InputError, quote, shorten
from sim.sensors.camera.unwrap import COEFFICIENTS, RawCamera
from sim.settings import Group


class WheelConfig(Group):
    """The wheels."""

    topic: str = Field(default="/joint_states", min_length=1, max_length=300)
    """Topic of the wheels: JointState, or Odometry, from whose path the wheels' angles are computed."""
    left: str = Field(default="wheel_left_joint", min_length=1, max_length=300)
    """Name of the left wheel's joint."""
    right: str = Field(default="wheel_right_joint", min_length=1, max_length=300)
    """Name of the right wheel's joint."""
    backward: Literal["none", "left", "right", "both"] = "none"
    """Wheels whose angles fall when the robot drives forward, as of a motor mounted the other way round."""
    radius_m: float = Field(gt=0.001, le=1.0)
    """Radius of the wheels [m]."""
    track_m: float = Field(gt=0.01, le=3.0)
    """Distance between the wheels [m]."""
    ticks_per_rev: int = Field(default=4096, ge=4, le=2**24)
    """Ticks of a revolution of the wheel (TurtleBot3: 4096), to which angles are rounded."""
    lag_s: float | Literal["estimate"] = Field(default=0.0, union_mode="left_to_right")
    """How much older than their stamps the angles are, against the images [s] (TurtleBot3: 0.05); estimate: it is
    measured from the turns that both the wheels and the images see."""

    @field_validator("lag_s", mode="before")
    @classmethod
    def _lag_is_short(cls, value: Any) -> Any:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value != "estimate" and not (number and -1.0 <= value <= 1.0):
            raise ValueError(f"{quote(value)} must be from -1 to 1 s, or estimate")
        return value


class Intrinsics(Group):
    """Calibration of the camera, if the log has none; as in a CameraInfo."""

    model: Literal["equidistant", "fisheye", "kannala_brandt", "plumb_bob", "rational_polynomial", "omni"] = (
        "equidistant"
    )
    """Model of the lens: equidistant, fisheye and kannala_brandt are the same, with 4 coefficients; plumb_bob has 5,
    rational_polynomial 8, and omni 5: xi, k1, k2, p1, p2."""
    width: int = Field(ge=16, le=32_000)
    """Columns of the image."""
    height: int = Field(ge=16, le=32_000)
    """Rows of the image."""
    fx: float = Field(gt=1.0, le=1e5)
    """Focal length along the columns [px]."""
    fy: float = Field(gt=1.0, le=1e5)
    """Focal length along the rows [px]."""
    cx: float = Field(ge=0.0, le=32_000.0)
    """Column of the optical axis [px]."""
    cy: float = Field(ge=0.0, le=32_000.0)
    """Row of the optical axis [px]."""
    coefficients: tuple[float, ...] = Field(default=(), max_length=14)
    """Distortion coefficients; missing ones are 0, and more of them must be."""

    @property
    def camera(self) -> RawCamera:
        """The calibration with all of its model's coefficients; raises InputError if more than these are not 0."""
        count, numbers = COEFFICIENTS[self.model], self.coefficients
        if any(numbers[count:]):
            raise InputError(f"{self.model} has {count} coefficients, not {len(numbers)}")
        padded = (*numbers, *[0.0] * count)[:count]
        return RawCamera(self.model, (self.width, self.height), (self.fx, self.fy), (self.cx, self.cy), padded)


class CameraConfig(Group):
    """The upward camera."""

    topic: str = Field(min_length=1, max_length=300)
    """Topic of the images: Image or CompressedImage."""
    info: str | None = Field(default=None, max_length=300)
    """Topic of the calibration, a CameraInfo; None: ``intrinsics`` or ``file``."""
    file: Path | None = None
    """File of the calibration, by ROS's camera_calibration, Kalibr or OpenCV; relative to this one."""
    intrinsics: Intrinsics | None = None
    """The calibration itself."""
    field_of_view_deg: float | None = Field(default=None, ge=60.0, le=190.0)
    """Full angle of the image cone that is used [deg]; None: the largest circle inside the image, at most 190."""
    circle_px: float | None = Field(default=None, gt=8.0, le=16_000.0)
    """Radius of the lens's image circle [px], beyond which there is nothing to see; None: it fills the image."""
    height_m: float = Field(default=0.35, ge=0.05, le=3.0)
    """Height of the lens above the floor [m]."""
    forward_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """Direction of the robot's front in the image, clockwise from its top [deg]."""
    mirrored: bool = False
    """Whether images are mirror images, so that something to the robot's left is seen at the left of its front."""
    rings: int = Field(default=32, ge=4, le=256)
    """Rows of the polar image, from the zenith to the rim."""
    sectors: int = Field(default=128, ge=8, le=1024)
    """Columns of the polar image, once around."""

    @model_validator(mode="after")
    def _one_calibration(self) -> "CameraConfig":
        given = [name for name in ("info", "file", "intrinsics") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)}: give one of them")
        if not given and (self.field_of_view_deg is None or self.circle_px is None):
            raise ValueError("without info, file or intrinsics, field_of_view_deg and circle_px are needed")
        return self


class PoseConfig(Group):
    """Poses that something else measured, such as motion capture."""

    topic: str = Field(min_length=1, max_length=300)
    """Topic of the poses: PoseStamped, PoseWithCovarianceStamped, TransformStamped or Odometry."""
    use: Literal["truth", "labels"] = "truth"
    """truth: only evaluation and supervised methods see them; labels: supervised methods alone learn from them."""


class DriveConfig(Group):
    """What is taken from the drive."""

    spacing_m: float = Field(default=0.08, ge=0.01, le=1.0)
    """Distance between images on a segment [m]; those in between are left out."""
    held_out: float = Field(default=0.1, ge=0.0, le=0.5)
    """Last part of the segments, as a fraction, that is not trained on: it tests what was learned. Of three segments or
    more it is at least one, unless the fraction is 0."""


class RobotConfig(Group):
    """The robot and its log."""

    wheels: WheelConfig
    camera: CameraConfig
    pose: PoseConfig | None = None
    drive: DriveConfig = DriveConfig()
    clocks: Literal["checked", "logged"] = "checked"
    """checked: the stamps of messages count, and the log is refused where clocks differ by more than 50 ms or jump;
    logged: the times at which messages were logged count."""


def load_config(path: Path) -> RobotConfig:
    """Read ``robot.yaml``; raises InputError that names the setting, its value and what is allowed."""
    values = read_yaml(path)
    try:
        config = RobotConfig.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{shorten(str(path), 300)}: {describe_problems(error, RobotConfig)}") from None
    if config.camera.file is None:
        return config
    camera = config.camera.model_copy(update={"file": path.parent / config.camera.file})
    return config.model_copy(update={"camera": camera})
