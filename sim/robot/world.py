"""The room as a world: the compiled scene, its state, the robot's motors and sensors, and the ground truth."""

from functools import cached_property

import mujoco
import numpy as np

from sim.geometry import FreeSpace, limits
from sim.robot.calibrate import calibrate_own
from sim.robot.chassis import Chassis
from sim.robot.model import describe_body
from sim.robot.range_finder import REACH_M, RangeFinder
from sim.rooms.build import build_room
from sim.rooms.deployment import change_room
from sim.rooms.free_space import find_free_space
from sim.rooms.spec import bare
from sim.settings import SimSettings


class RoomWorld(Chassis):
    """A robot in a room, moved by physics; ``room`` is the compiled room without it."""

    def __init__(self, settings: SimSettings, room: mujoco.MjSpec | None = None, drawn: bool = True) -> None:
        """Build the settings' room as before deployment, or take a given one, and put the robot into it at rest.

        ``drawn`` tells whether ``model`` includes geoms that nothing can touch; physics is a third faster without them.
        """
        still = change_room(build_room(settings.room) if room is None else room, settings.deployment)
        # the dimensions of a user's own robot are measured in two drives on an empty floor
        body = describe_body(settings.camera) if settings.robot.mjcf is None else calibrate_own(settings)
        super().__init__(settings, still if drawn else bare(still), body)
        self.room = still.compile()
        self._finder = RangeFinder(still, self.body.height_m, self.body.radius_m)

    @cached_property
    def free_space(self) -> FreeSpace:
        """Where the robot fits."""
        return find_free_space(self.room, self.body.radius_m, self.body.height_m)

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner (2, 2) of the bounding box of all places that the robot can reach [m]."""
        return np.array(limits(self.free_space, 0.0))

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot fits with its middle at ``points`` (..., 2) [m]."""
        return self.free_space.is_free(points)

    def start(self, rng: np.random.Generator) -> None:
        """Place the robot at the room's start with a random heading."""
        self.place(np.array((*self.free_space.start, rng.uniform(-np.pi, np.pi))))

    def carry(self, rng: np.random.Generator) -> None:
        """Relocate the robot, at rest, to the start with a random heading; wheel angles and time do not change."""
        pose = np.array((*self.free_space.start, rng.uniform(-np.pi, np.pi)))
        self.data.qpos[:7] = self.rest_states(pose[None])[0, :7]
        self.data.qvel[:] = self.data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def ranges(self, reach_m: float = REACH_M, turned_rad: float = 0.0) -> np.ndarray:
        """Distances (K,) of the range rays [m], at most the reach, fan after fan, which are turned to the left
        [rad]."""
        x, y, yaw = self.pose().tolist()
        return self._finder.measure(x, y, yaw + turned_rad, reach_m)
