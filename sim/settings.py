"""Settings of world, robot, sensors and driving: frozen groups, each checked once when it is created."""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from sim.plugins import ENCODER_FAULTS, HOW_TO_LOAD
from sim.user_input import shorten

WorldName = Literal["room", "landmarks", "obstacles"]
SensorName = Literal["fisheye", "lidar"]
RoomKind = Literal["living_room", "bedroom", "office", "kitchen", "studio", "workshop", "lab", "corridor", "labyrinth"]
RoomShape = Literal["rectangle", "l", "u", "pillar", "two_rooms"]
SMALLEST_M: dict[RoomKind, float] = {"corridor": 6.0, "labyrinth": 3.0}
"""Smallest width and depth [m] of the kinds with walls inside, whose only shape is a rectangle."""
LARGEST_MJCF = 64 * 1024 * 1024
"""Largest size of each XML file of a user's own room, in bytes."""
LARGEST_GRID = 250_000_000
"""Most distances that a test grid in a plane holds: 1 GB."""
FEWEST_SAMPLES = 16
"""Fewest images of a drive."""
Metres = Annotated[float, Field(ge=2.0, le=30.0)]


class Group(BaseModel):
    """A frozen group of settings; unknown keys, infinities, NaN and true or false in place of a number are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _true_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        if _holds_bool(value) and _takes_only_numbers(cls.model_fields[str(info.field_name)].annotation):
            raise PydanticCustomError("number_type", "Input should be numeric, not true or false")
        return value


def _holds_bool(value: Any) -> bool:
    if isinstance(value, Mapping):
        return any(map(_holds_bool, value.values()))
    return isinstance(value, bool) or (isinstance(value, list | tuple) and any(map(_holds_bool, value)))


def _takes_only_numbers(annotation: Any) -> bool:
    """Whether a field of this type, or a list or table in it, takes numbers but neither true nor groups that may."""
    parts = list(_list_types(annotation))
    groups = any(isinstance(part, type) and issubclass(part, Group) for part in parts)
    return (int in parts or float in parts) and bool not in parts and Any not in parts and not groups


def _list_types(annotation: Any) -> Iterator[Any]:
    """The types that a type is composed of; those of a Literal are its values."""
    yield annotation
    for part in get_args(annotation):
        yield from _list_types(part)


class WithLater(Group):
    """A group whose later settings are not written while they have their defaults: recordings keep their hash.

    Attributes:
        later: Names of the settings that are younger than the group.
    """

    later: ClassVar[frozenset[str]] = frozenset()

    @model_serializer(mode="wrap")
    def _write_later_settings_only_if_given(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        usual = {name: type(self).model_fields[name].default for name in self.later}
        return {name: value for name, value in write(self).items() if name not in usual or value != usual[name]}


class WithPlugins(Group):
    """A group with a dictionary ``plugins``: an empty one is not written, so a run without plugins keeps its hash."""

    def __hash__(self) -> int:
        return hash(self.model_dump_json())  # a dictionary has no hash

    @model_serializer(mode="wrap")
    def _write_plugins_only_if_there_are_some(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values = write(self)
        if not values.get("plugins"):
            values.pop("plugins", None)
        return values


class RoomSettings(WithLater):
    """The room to build, or the MJCF file to use instead."""

    later = frozenset({"look_alike"})

    kind: RoomKind = "living_room"
    """Purpose of the room, which determines its furniture."""
    shape: RoomShape = "rectangle"
    """Outline of the walls; two_rooms: a wall between two rooms, with a doorway."""
    seed: int = Field(default=0, ge=0)
    """Seed of everything random about the room."""
    width_m: Metres | None = None
    """Extent along x [m]; None: the default of the kind."""
    depth_m: Metres | None = None
    """Extent along y [m]; None: the default of the kind."""
    look_alike: bool = False
    """Places look alike: all walls have the same wallpaper, whose motif repeats, the ceiling has panels with the same
    lamp at regular distances, and pieces of furniture of one name are the same. In a labyrinth, all walls have one
    texture in place of two to four."""
    mjcf: str | None = Field(default=None, max_length=4096, pattern=r"^[^\x00]*$")
    """Your own room: path of an MJCF file, used instead of kind, shape, seed, size and look_alike."""

    @model_validator(mode="after")
    def _walls_inside_have_room(self) -> "RoomSettings":
        if self.kind == "lab" and self.look_alike:
            raise ValueError("look_alike: a lab has tags that are all different")
        smallest = SMALLEST_M.get(self.kind)
        if smallest is None or self.mjcf is not None:
            return self
        if self.shape != "rectangle":
            raise ValueError(f"shape {self.shape}: a {self.kind} has walls of its own inside a rectangle")
        for name, size in (("width_m", self.width_m), ("depth_m", self.depth_m)):
            if size is not None and size < smallest:
                raise ValueError(f"{name} {size:g}: a {self.kind} needs at least {smallest:g} m")
        return self


class LandmarksSettings(Group):
    """The paper's planar world: a square with landmarks; the robot senses only its distances to them (Sec. IV-A)."""

    count: int = Field(default=128, ge=3, le=4096)
    """Number of landmarks; they are identifiable, so each distance is assigned to its landmark."""
    seed: int | None = Field(default=None, ge=0)
    """Seed of the landmarks' positions; None: the scenario's seed."""
    side_m: float = Field(default=2.0, ge=0.5, le=100.0)
    """Side of the square, its middle at the origin [m]."""
    reach_m: float | None = Field(default=None, gt=0.0, le=1e6)
    """Farther landmarks are not seen: their distance reads as this [m] (the paper's d_max); None: no limit."""
    segments: int = Field(default=128, ge=1, le=1_000_000)
    """Straight segments to drive, each from wall to wall; drive.samples may end the drive earlier."""


class ObstaclesSettings(Group):
    """The paper's lidar maps (its appendix): a walled square with rectangular obstacles along its axes."""

    seed: int | None = Field(default=None, ge=0)
    """Seed of the obstacles; None: the scenario's seed."""
    side_m: float = Field(default=2.0, ge=0.5, le=100.0)
    """Side of the square, its middle at the origin [m]."""
    count: int = Field(default=20, ge=0, le=1000)
    """Rectangles with sides of 3 to 20 % of the square's; they may overlap, or leave passages of 6 %."""
    clearance_m: float = Field(default=0.02, ge=0.0, le=1.0)
    """The robot is a point that keeps this distance from walls and obstacles [m]."""
    relocate_after: int = Field(default=10, ge=0, le=1_000_000)
    """Segments after which the robot is relocated at random without being informed; 0: it never is."""


class LidarSettings(Group):
    """The lidar: ordered distances all around the robot in one plane."""

    rays: int = Field(default=256, ge=8, le=4096)
    """Rays of one scan, evenly spaced, the first straight ahead."""
    headings: int = Field(default=1, ge=1, le=64)
    """Scans at each place, each turned from the last by 1 / headings of the angle between two rays. A turn by a full
    ray only shifts a scan circularly, so that training can draw any of rays x headings."""
    reach_m: float = Field(default=8.0, ge=0.1, le=1000.0)
    """Longest distance measured [m] (LDS-02, the TurtleBot3's lidar: 8 m); also the reading if nothing is nearer."""
    height_m: float = Field(default=0.18, ge=0.02, le=1.5)
    """Height of the rays above the floor, in rooms [m] (TurtleBot3 Burger: 0.18)."""
    noise_m: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of each distance [m]."""


class RobotSettings(Group):
    """Faults of the robot's body."""

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
        own = ("mjcf", "left_joint", "right_joint", "camera_site")
        return {name: value for name, value in write(self).items() if name not in own or self.mjcf is not None}

    @model_validator(mode="after")
    def _only_our_wheel_can_be_scaled(self) -> "RobotSettings":
        if self.mjcf is not None and self.wheel_radius_error:
            raise ValueError(f"wheel_radius_error {self.wheel_radius_error:g} must be 0 with a robot of your own")
        return self


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
    field_of_view_deg: float = Field(default=100.0, ge=30.0, le=120.0)
    """Full angle across the image [deg]."""
    width_px: int = Field(default=960, ge=64, le=4096)
    """Columns of the image."""
    height_px: int = Field(default=540, ge=64, le=4096)
    """Rows of the image."""
    height_m: float = Field(default=0.28, ge=0.1, le=1.5)
    """Height of its middle above the floor [m]."""
    ahead_m: float = Field(default=-0.04, ge=-0.1, le=0.1)
    """Distance in front of the wheel axle [m]."""
    yaw_deg: float = Field(default=180.0, ge=-180.0, le=180.0)
    """Direction of view, left of straight ahead [deg]; backwards by default, as the robot stops at obstacles."""
    kept: bool = False
    """Whether the recording keeps its images, 0.5 MB each, in addition to the tags found in them."""


class FaultSetting(Group):
    """Strength of a fault that a plugin defines, and the checksum of the plugin's source."""

    value: float
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class EncoderSettings(WithPlugins):
    """The wheel encoders and their faults; all but the first two are faults of measurement."""

    ticks_per_rev: int = Field(default=4096, ge=4, le=65536)
    """Ticks per wheel revolution (TurtleBot3: 4096)."""
    rounding: Literal["floor", "nearest"] = "floor"
    """How an angle is rounded to integer ticks."""
    radius_error_left: float = Field(default=0.0, ge=-0.5, le=0.5)
    """The left wheel's assumed radius is wrong by this fraction; its distances scale with 1 + the fraction."""
    radius_error_right: float = Field(default=0.0, ge=-0.5, le=0.5)
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
    plugins: dict[str, FaultSetting] = Field(default_factory=dict)
    """Faults that plugins define: their strengths by name."""

    @field_validator("plugins", mode="before")
    @classmethod
    def _add_the_checksums(cls, given: Any) -> Any:
        return {name: _add_checksum(name, value) for name, value in given.items()} if _is_mapping(given) else given

    @field_validator("plugins")
    @classmethod
    def _leave_out_what_is_off(cls, plugins: dict[str, FaultSetting]) -> dict[str, FaultSetting]:
        for name, setting in plugins.items():
            low, high = ENCODER_FAULTS[name].limits if name in ENCODER_FAULTS else (-float("inf"), float("inf"))
            if setting.value and not low <= setting.value <= high:
                raise ValueError(f"{shorten(name)} {setting.value}: must be from {low:g} to {high:g}, or 0")
        return {name: plugins[name] for name in sorted(plugins) if plugins[name].value}


def _add_checksum(name: str, value: Any) -> Any:
    """A fault's setting with the checksum of the loaded plugin's source, unless it holds one."""
    if isinstance(value, FaultSetting) or (_is_mapping(value) and "sha256" in value):
        return value  # of a run or a recording, which can be opened without the plugin
    if name not in ENCODER_FAULTS:
        raise ValueError(f"no plugin that is loaded defines {shorten(str(name))}; {HOW_TO_LOAD}")
    source = ENCODER_FAULTS[name].source
    given = dict(value) if _is_mapping(value) else {"value": value}
    return {**given, "sha256": source.sha256 if source else ""}


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)


class DriveSettings(WithLater):
    """How the robot drives and when it looks."""

    later = frozenset({"mixed_light", "arcs"})

    strategy: Literal["dense", "endpoint"] = "dense"
    """dense: an image every spacing_m; endpoint: images only where a straight segment begins and ends."""
    samples: int = Field(default=8000, ge=FEWEST_SAMPLES, le=2_000_000)
    """Images to collect."""
    spacing_m: float = Field(default=0.08, ge=0.01, le=1.0)
    """Distance between images on a segment [m]; at least what a robot in a room drives in 0.04 s."""
    speed_mps: float = Field(default=0.22, gt=0.01, le=0.5)
    """Cruising speed [m/s] (TurtleBot3 Burger: 0.22)."""
    turn_rate_rps: float = Field(default=1.8, gt=0.1, le=2.84)
    """Speed of turns in place [rad/s] (TurtleBot3 Burger: at most 2.84)."""
    stop_distance_m: float = Field(default=0.04, ge=0.0, le=1.0)
    """The robot stops when a range ray shows less room than this in front of its body [m]."""
    longest_m: float = Field(default=5.0, ge=0.2, le=50.0)
    """Longest straight segment [m]."""
    lengths: Literal["longest", "random"] = "longest"
    """longest: each segment is as long as possible; random: each draws its own length up to longest_m, so that it ends
    at a random place, as the paper's end-point strategy requires."""
    turn_images: bool = True
    """Whether the robot takes a second image after each turn in place, from which the angle turned is measured; these
    are not counted in samples."""
    headings: Literal["explore", "random"] = "explore"
    """explore: of twelve random headings the robot takes the one over the floor that it visited longest ago, by its
    wheels; random: it takes any heading, as in the paper."""
    enter: float = Field(default=0.2, ge=0.0, le=1.0)
    """Probability of turning into a gap that the robot passes. A robot that explores always turns into a gap if it
    visited the floor behind it longer ago than the floor ahead."""
    search: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability, after a segment, of searching one side for a while for places that random driving would miss."""
    mixed_light: bool = False
    """Whether the light changes every 256 images of the training drive: as usual, little daylight, lamps off, night."""
    arcs: float = Field(default=0.0, ge=0.0, le=0.9)
    """Probability, before a segment, of driving an arc first, on which no image is taken; only logs show it."""


class GridSettings(Group):
    """The test grid, rendered while collecting so that nothing later needs the simulator."""

    spacing_m: float = Field(default=0.08, ge=0.005, le=1.0)
    """Distance between test positions [m]."""
    headings: int = Field(default=4, ge=1, le=64)
    """Headings at each test position, evenly spaced from +x."""
    held_out: int = Field(default=0, ge=0, le=100_000)
    """Held-out samples, driven after the training samples, that replace the grid as test positions; 0: the grid."""


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
    sensor_px: int = Field(default=480, ge=16, le=8192)
    """Diameter of the image's circle on the sensor [px]; a polar pixel is the mean of the sensor pixels it covers."""
    turn_deg: float = Field(default=0.0, ge=0.0, le=90.0)
    """Angle that the robot turns while the shutter is open, which smears each ring: turn rate x exposure time [deg]."""


class MountSettings(WithLater):
    """A mounting of the camera."""

    later = frozenset({"ahead_m", "left_m", "centre_px"})


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
    """In each image, a person stands at another random free place; physics does not know of it."""
    moved_m: float = Field(default=0.0, ge=0.0, le=2.0)
    """Distance by which chairs and other small furniture have been pushed, each in a random feasible direction [m]."""
    seed: int = Field(default=0, ge=0)
    """Seed of these directions, of the person's places and of the place of the lamp that is on."""
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


class SimSettings(Group):
    """All settings that determine a recording."""

    world: WorldName = "room"
    """room: a furnished room in MuJoCo; landmarks: a plane with landmarks; obstacles: a plane with obstacles, sensed by
    a lidar. The planar worlds have neither camera nor physics."""
    sensor: SensorName = "fisheye"
    """Sensor in a room. fisheye: the upward camera; lidar: horizontal rays all around, which need no renderer."""
    room: RoomSettings = RoomSettings()
    landmarks: LandmarksSettings = LandmarksSettings()
    obstacles: ObstaclesSettings = ObstaclesSettings()
    lidar: LidarSettings = LidarSettings()
    robot: RobotSettings = RobotSettings()
    camera: CameraSettings = CameraSettings()
    tag_camera: TagCameraSettings = TagCameraSettings()
    encoder: EncoderSettings = EncoderSettings()
    drive: DriveSettings = DriveSettings()
    grid: GridSettings = GridSettings()
    image_faults: ImageFaultSettings = ImageFaultSettings()
    camera_mount: CameraMountSettings = CameraMountSettings()
    deployment: DeploymentSettings = DeploymentSettings()

    @model_validator(mode="after")
    def _segments_have_room(self) -> "SimSettings":
        if self.world == "room":
            return self
        side_m = (
            self.landmarks.side_m
            if self.world == "landmarks"
            else self.obstacles.side_m - 2 * self.obstacles.clearance_m
        )
        longest = min(side_m, self.drive.longest_m)
        if 4 * self.drive.spacing_m > longest:
            raise ValueError(
                f"drive.spacing_m {self.drive.spacing_m} m must be at most a quarter of the longest segment in the "
                f"{self.world} world, {longest:g} m"
            )
        return self

    @model_validator(mode="after")
    def _a_test_grid_fits_into_memory(self) -> "SimSettings":
        if self.world == "room":
            return self
        side_m, values = (
            (self.landmarks.side_m, self.landmarks.count)
            if self.world == "landmarks"
            else (self.obstacles.side_m, self.lidar.rays * self.lidar.headings)
        )
        least_m = side_m / (math.sqrt(LARGEST_GRID / (values * self.grid.headings)) - 1.0)
        if self.grid.spacing_m < least_m:
            raise ValueError(
                f"grid.spacing_m {self.grid.spacing_m:g} m must be at least {math.ceil(1000 * least_m) / 1000:g} m in "
                f"a square of {side_m:g} m with grid.headings {self.grid.headings} and {values} distances in an "
                f"observation: a test grid holds at most {LARGEST_GRID:,} distances"
            )
        return self

    @model_validator(mode="after")
    def _a_site_places_the_camera_of_an_own_robot(self) -> "SimSettings":
        if self.robot.mjcf is not None and self.camera.height_m != CameraSettings().height_m:
            raise ValueError(
                f"camera.height_m {self.camera.height_m:g} must be left out with robot.mjcf: its site "
                f"{shorten(self.robot.camera_site)} places the camera"
            )
        return self

    @model_validator(mode="after")
    def _only_a_room_is_seen(self) -> "SimSettings":
        if self.world != "room" and self.tag_camera.mounted:
            raise ValueError(f"tag_camera.mounted needs world room, and the world is {self.world}")
        if self.tag_camera.mounted and self.room.mjcf is None and self.room.kind != "lab":
            raise ValueError(f"tag_camera.mounted needs tags: room.kind lab has some, and {self.room.kind} has none")
        if self.world != "room" and self.grid.held_out:
            raise ValueError(f"grid.held_out {self.grid.held_out} needs world room, and the world is {self.world}")
        if self.world != "room" and self.deployment.drive_samples:
            raise ValueError(
                f"deployment.drive_samples {self.deployment.drive_samples} needs world room, and the world is "
                f"{self.world}"
            )
        default = DriveSettings()
        changed = [name for name in DRIVES_IN_ROOMS if getattr(self.drive, name) != getattr(default, name)]
        if self.world != "room" and changed:
            value = getattr(self.drive, changed[0])
            raise ValueError(f"drive.{changed[0]} {value} needs world room, and the world is {self.world}")
        return self

    @model_validator(mode="after")
    def _only_a_camera_has_its_faults(self) -> "SimSettings":
        if self.drive.mixed_light and (self.world != "room" or self.sensor != "fisheye"):
            raise ValueError("drive.mixed_light needs world room and sensor fisheye")
        changes = self.deployment.model_copy(update={"drive_samples": 0})  # any sensor can be driven with
        faulty = self.model_copy(update={"deployment": changes})
        faults = [name for name, off in NO_FAULTS.items() if getattr(faulty, name) != off]
        if faults and (self.world != "room" or self.sensor != "fisheye"):
            raise ValueError(f"{faults[0]} has faults of images, which need world room and sensor fisheye")
        if changes != DeploymentSettings() and self.grid.held_out:
            raise ValueError(
                f"deployment changes the room of the test grid, and grid.held_out {self.grid.held_out} has none"
            )
        if self.deployment.moved_m and self.room.mjcf is not None:
            raise ValueError(
                "deployment.moved_m needs a room whose furniture is known, and room.mjcf is one of your own"
            )
        return self


DRIVES_IN_ROOMS = ("strategy", "lengths", "headings", "enter", "search", "arcs", "stop_distance_m")
"""Settings of the drive that a robot in a plane, which has no range finder, does not use."""
NO_FAULTS: dict[str, Group] = {
    "image_faults": ImageFaultSettings(),
    "camera_mount": CameraMountSettings(),
    "deployment": DeploymentSettings(),
}
"""Groups of image faults with their default values, which are off."""
