"""Settings of world, robot, sensors and driving."""

import math

from pydantic import model_validator

from sim.errors import shorten
from sim.settings.group import Group
from sim.settings.robot import (
    CameraMountSettings,
    CameraSettings,
    DeploymentSettings,
    EncoderSettings,
    ImageFaultSettings,
    LidarSettings,
    RobotSettings,
    SensorName,
    TagCameraSettings,
)
from sim.settings.robot import DeploymentImageFaultSettings as DeploymentImageFaultSettings
from sim.settings.robot import DeploymentMountSettings as DeploymentMountSettings
from sim.settings.world import (
    PLANE_CLEARANCE_M,
    PLANE_SIDE_M,
    DriveSettings,
    GridSettings,
    LandmarksSettings,
    ObstaclesSettings,
    RoomSettings,
    WorldName,
)
from sim.settings.world import TURN_RATE_RPS as TURN_RATE_RPS
from sim.settings.world import RoomKind as RoomKind
from sim.settings.world import RoomShape as RoomShape
from sim.settings.world import UntilSettings as UntilSettings

MAX_GRID_DISTANCES = 250_000_000  # Most distances that a test grid in a plane holds: 1 GB


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
    def _drive_and_test_grid_fit_into_a_plane(self) -> "SimSettings":
        if self.world == "room":
            return self
        side_m = PLANE_SIDE_M if self.world == "landmarks" else PLANE_SIDE_M - 2 * PLANE_CLEARANCE_M
        longest = min(side_m, self.drive.longest_m)
        if 4 * self.drive.spacing_m > longest:
            raise ValueError(
                f"drive.spacing_m {self.drive.spacing_m} m must be at most a quarter of the longest segment in the "
                f"{self.world} world, {longest:g} m"
            )
        values = self.landmarks.count if self.world == "landmarks" else self.lidar.rays * self.lidar.headings
        least_m = PLANE_SIDE_M / (math.sqrt(MAX_GRID_DISTANCES / (values * self.grid.headings)) - 1.0)
        if self.grid.spacing_m < least_m:
            raise ValueError(
                f"grid.spacing_m {self.grid.spacing_m:g} m must be at least {math.ceil(1000 * least_m) / 1000:g} m in "
                f"a square of {PLANE_SIDE_M:g} m with grid.headings {self.grid.headings} and {values} distances in an "
                f"observation: a test grid holds at most {MAX_GRID_DISTANCES:,} distances"
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
        if self.world == "room":
            kind = self.room.kind
            if self.tag_camera.mounted and self.room.mjcf is None and kind != "lab":
                raise ValueError(f"tag_camera.mounted needs tags: room.kind lab has some, and {kind} has none")
            return self
        default = SimSettings.model_construct()
        for name in ROOM_SETTINGS:
            group, _, field = name.partition(".")
            value, usual = getattr(self, group), getattr(default, group)
            if field:
                value, usual = getattr(value, field), getattr(usual, field)
            if value != usual:
                shown = "" if isinstance(value, bool | Group) else f" {value}"
                raise ValueError(f"{name}{shown} needs world room, and the world is {self.world}")
        return self

    @model_validator(mode="after")
    def _held_out_samples_are_of_a_whole_drive(self) -> "SimSettings":
        if self.drive.until.unseen is not None and self.grid.held_out:
            raise ValueError(
                f"drive.until.unseen ends a drive early, and grid.held_out {self.grid.held_out} follows it"
            )
        return self

    @model_validator(mode="after")
    def _only_a_camera_has_its_faults(self) -> "SimSettings":
        for name in ("mixed_light", "person"):
            if getattr(self.drive, name) and (self.world != "room" or self.sensor != "fisheye"):
                raise ValueError(f"drive.{name} needs world room and sensor fisheye")
        # any sensor can be driven with
        changes = self.deployment.model_copy(update={"drive_samples": 0})
        faulty = self.model_copy(update={"deployment": changes})
        faults = [name for name, off in NO_FAULTS.items() if getattr(faulty, name) != off]
        if faults and (self.world != "room" or self.sensor != "fisheye"):
            raise ValueError(f"{faults[0]} changes what a camera sees, so it needs world room and sensor fisheye")
        if changes != DeploymentSettings() and self.grid.held_out:
            raise ValueError(
                f"deployment changes the room of the test grid, and grid.held_out {self.grid.held_out} has none"
            )
        if self.deployment.moved_m and self.room.mjcf is not None:
            raise ValueError(
                "deployment.moved_m needs a room whose furniture is known, and room.mjcf is one of your own"
            )
        return self


ROOM_SETTINGS = ("tag_camera.mounted", "robot", "grid.held_out", "deployment.drive_samples")
ROOM_SETTINGS += tuple(f"drive.{name}" for name in ("strategy", "lengths", "headings", "enter", "search"))
"""Settings without effect in a plane, where the robot has no range finder."""
NO_FAULTS: dict[str, Group] = {
    "image_faults": ImageFaultSettings(),
    "camera_mount": CameraMountSettings(),
    "deployment": DeploymentSettings(),
}
"""Groups of image faults with their default values, which are off."""
