"""Settings of the world, a room or one of the paper's planes, of the drive in it and of the test grid."""

from operator import not_
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PlainSerializer, model_validator

from sim.settings.group import Group, Seed

WorldName = Literal["room", "landmarks", "obstacles"]
UndividedKind = Literal["living_room", "bedroom", "office", "kitchen", "studio", "workshop", "lab"]
RoomKind = Literal[UndividedKind, "corridor", "labyrinth", "flat"]
RoomShape = Literal["rectangle", "l", "u", "pillar", "two_rooms"]
MIN_ROOM_SIDE_M: dict[RoomKind, float] = {"corridor": 6.0, "labyrinth": 3.0, "flat": 7.0}
"""Smallest width and depth [m] of the kinds with walls inside, whose only shape is a rectangle."""
_NEVER_ALIKE = {"lab": "tags", "flat": "rooms"}
Metres = Annotated[float, Field(ge=2.0, le=30.0)]


class RoomSettings(Group):
    """The room to build, or the MJCF file to use instead."""

    kind: RoomKind = "living_room"
    """Purpose of the room, which determines its furniture."""
    shape: RoomShape = "rectangle"
    """Outline of the walls; two_rooms: a wall between two rooms, with a doorway."""
    seed: Seed = 0
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
        if self.kind in _NEVER_ALIKE and self.look_alike and self.mjcf is None:
            raise ValueError(f"look_alike: a {self.kind} has {_NEVER_ALIKE[self.kind]} that are all different")
        smallest = MIN_ROOM_SIDE_M.get(self.kind)
        if smallest is None or self.mjcf is not None:
            return self
        if self.shape != "rectangle":
            raise ValueError(f"shape {self.shape}: a {self.kind} has walls of its own inside a rectangle")
        for name, size in (("width_m", self.width_m), ("depth_m", self.depth_m)):
            if size is not None and size < smallest:
                raise ValueError(f"{name} {size:g}: a {self.kind} needs at least {smallest:g} m")
        return self


PLANE_SIDE_M = 2.0  # Side of the square of the planar worlds, its middle at the origin [m]
PLANE_CLEARANCE_M = 0.02  # Among obstacles, the robot is a point that keeps this distance from them and from walls [m]


class LandmarksSettings(Group):
    """The paper's planar world: a square with landmarks; the robot senses only its distances to them (Sec. IV-A)."""

    count: int = Field(default=128, ge=3, le=4096)
    """Number of landmarks; they are identifiable, so each distance is assigned to its landmark."""
    reach_m: float | None = Field(default=None, gt=0.0, le=1e6)
    """Farther landmarks are not seen: their distance reads as this [m] (the paper's d_max); None: no limit."""
    segments: int = Field(default=128, ge=1, le=1_000_000)
    """Straight segments to drive, each from wall to wall; drive.samples may end the drive earlier."""


class ObstaclesSettings(Group):
    """The paper's lidar maps (its appendix): a walled square with rectangular obstacles along its axes."""

    seed: Seed | None = None
    """Seed of the obstacles; None: the scenario's seed."""


# None and one are written as false and true, as in recordings from before there could be more
Persons = Annotated[
    Annotated[int, Field(ge=0, le=3)] | bool,
    AfterValidator(int),
    PlainSerializer(lambda count: count if count > 1 else bool(count)),
]
MIN_SAMPLES = 16  # Fewest images of a drive
TURN_RATE_RPS = 1.8  # Speed of turns in place [rad/s] (TurtleBot3 Burger: at most 2.84)


class UntilSettings(Group):
    """When the drive is done, before drive.samples."""

    unseen: float | None = Field(default=None, ge=0.0, le=0.5)
    """Share of the floor without an image within 0.25 m, by the robot's own map, from which the drive is done; null: it
    ends with drive.samples. It needs drive.headings map or frontier."""
    radius_m: float | None = Field(default=None, gt=0.0, le=1.0, exclude_if=lambda radius_m: radius_m is None)
    """Largest radius within which registration on other segments must then place 68 % of the images [m]; else the drive
    goes on for half as many images again, and so on. It needs unseen, and methods that name registration."""


class DriveSettings(Group):
    """How the robot drives and when it looks."""

    strategy: Literal["dense", "endpoint"] = "dense"
    """dense: an image every spacing_m; endpoint: images only where a straight segment begins and ends."""
    samples: int = Field(default=8000, ge=MIN_SAMPLES, le=2_000_000)
    """Images to collect."""
    spacing_m: float = Field(default=0.08, ge=0.01, le=1.0)
    """Distance between images on a segment [m]; in a room, images are never closer than the robot drives in 0.04 s."""
    speed_mps: float = Field(default=0.22, gt=0.01, le=0.5)
    """Cruising speed [m/s] (TurtleBot3 Burger: 0.22)."""
    longest_m: float = Field(default=5.0, ge=0.2, le=50.0)
    """Longest straight segment [m]."""
    lengths: Literal["longest", "random"] = "longest"
    """longest: each segment is as long as possible; random: each draws its own length up to longest_m, so that it ends
    at a random place, as the paper's end-point strategy requires."""
    turn_images: bool = True
    """Whether the robot takes a second image after each turn in place, from which the angle turned is measured; these
    are not counted in samples."""
    headings: Literal["explore", "random", "map", "frontier"] = "explore"
    """explore: of twelve random headings the robot takes the one over the floor that it visited longest ago, by its
    wheels; random: it takes any heading, as in the paper; map: it draws a map of its own from its range rays, and goes
    to floor that it took no image near, then to floor that it passed least often; frontier: by the same map, to the
    nearest floor beside what is not known yet, else anywhere."""
    enter: float = Field(default=0.2, ge=0.0, le=1.0)
    """Probability of turning into an opening that the robot passes. A robot that explores always turns into an opening
    if it visited the floor behind it longer ago than the floor ahead; one with a map needs no chance."""
    search: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability, after a segment, of searching one side for a while for places that random driving would miss."""
    mixed_light: bool = False
    """Whether the light changes during the training drive, at the first end of a segment after every 256 images: as
    usual, little daylight, lamps off, night."""
    person: Persons = Field(default=0, exclude_if=not_)
    """Persons who walk and stand in view during the training drive, at most 3; as deployment.person."""
    until: UntilSettings = Field(default=UntilSettings(), exclude_if=lambda until: until == UntilSettings())

    @model_validator(mode="after")
    def _only_a_map_tells_when_it_is_done(self) -> "DriveSettings":
        if self.until.unseen is not None and self.headings not in ("map", "frontier"):
            raise ValueError(f"until.unseen needs headings map or frontier, which draw a map, not {self.headings}")
        if self.until.radius_m is not None and self.until.unseen is None:
            raise ValueError(
                f"until.radius_m {self.until.radius_m:g} is asked for after until.unseen, and that is null"
            )
        return self


class GridSettings(Group):
    """The test grid, rendered while collecting so that nothing later needs the simulator."""

    spacing_m: float = Field(default=0.08, ge=0.005, le=1.0)
    """Distance between test positions [m]; with landmarks, rounded so that it divides the side."""
    headings: int = Field(default=4, ge=1, le=64)
    """Headings at each test position, evenly spaced from +x."""
    held_out: int = Field(default=0, ge=0, le=100_000)
    """Held-out samples, driven after the training samples, that replace the grid as test positions; 0: the grid."""
