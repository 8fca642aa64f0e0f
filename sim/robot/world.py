"""The room as a world: the compiled scene, its state, the robot's motors and sensors, and the ground truth."""

import math
from functools import cached_property

import mujoco
import numpy as np

from sim.errors import WorkError
from sim.occupancy import FreeSpace
from sim.robot.model import BASE, BUMPER, CONTROL_PERIOD_S, RADIUS_M, TIMESTEP_S, WHEELS, robot_height
from sim.robot.range_finder import REACH_M, RangeFinder
from sim.robot.scene import compile_scene
from sim.rooms.build import build_room
from sim.rooms.deployment import change_room
from sim.rooms.free_space import find_free_space
from sim.rooms.spec import PREFIX, bare, empty_room
from sim.settings import SimSettings

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_SETTLE_S = 1.0


class RoomWorld:
    """A robot in a room, moved by physics.

    Attributes:
        model: The compiled scene.
        data: The state of the scene.
        room: The compiled room without the robot.
    """

    def __init__(self, settings: SimSettings, room: mujoco.MjSpec | None = None, drawn: bool = True) -> None:
        """Build the settings' room, or take a given one, and put the robot into it at rest.

        Args:
            settings: The room, its changes before deployment, the robot and the camera height are used.
            room: A room to use instead of the settings' own.
            drawn: Whether ``model`` includes geoms that nothing can touch; physics is a third faster without them.
        """
        still = change_room(build_room(settings.room) if room is None else room, settings.deployment)
        self.settings = settings
        self.model = compile_scene(still if drawn else bare(still), settings)
        self.data = mujoco.MjData(self.model)
        self.room = still.compile()
        self._finder = RangeFinder(still, robot_height(settings.camera))
        self._substeps = round(CONTROL_PERIOD_S / TIMESTEP_S)
        self._left, self._right = (self.model.sensor(PREFIX + name).adr[0] for name in WHEELS)
        self._bumper = self.model.sensor(PREFIX + BUMPER).adr[0]
        self._base = self.model.body(PREFIX + BASE).id
        self._rest = _settle(settings)

    @cached_property
    def free_space(self) -> FreeSpace:
        """Where the robot fits."""
        return find_free_space(self.room, RADIUS_M, robot_height(self.settings.camera))

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner (2, 2) of the bounding box of all places that the robot can reach [m]."""
        row, column = np.nonzero(self.free_space.reachable)
        cell = np.array([[column.min(), row.min()], [column.max(), row.max()]])
        return self.free_space.origin + cell * self.free_space.cell_m

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot fits with its middle at ``points`` (..., 2) [m]."""
        return self.free_space.is_free(points)

    def place(self, pose: np.ndarray) -> None:
        """Place the robot at a pose (3,) x, y [m], yaw [rad], settled and at rest, with wheel angles zero."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.rest_states(np.asarray(pose)[None])[0]
        mujoco.mj_forward(self.model, self.data)

    def start(self, rng: np.random.Generator) -> None:
        """Place the robot at the room's start with a random heading."""
        self.place(np.array((*self.free_space.start, rng.uniform(-np.pi, np.pi))))

    def carry(self, rng: np.random.Generator) -> None:
        """Relocate the robot, at rest, to the start with a random heading; wheel angles and time do not change."""
        pose = np.array((*self.free_space.start, rng.uniform(-np.pi, np.pi)))
        self.data.qpos[:7] = self.rest_states(pose[None])[0, :7]
        self.data.qvel[:] = self.data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def rest_states(self, poses: np.ndarray) -> np.ndarray:
        """Return full positions (n, nq) of the robot at rest at poses (n, 3), with wheel angles zero."""
        poses = np.asarray(poses, float)
        half = poses[:, 2] / 2
        w, i, j, k = self._rest[3:7]
        c, s = np.cos(half), np.sin(half)
        states = np.tile(self._rest, (len(poses), 1))
        states[:, :2] = poses[:, :2]
        states[:, 3:7] = np.stack([c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w], axis=-1)
        return states

    def step(self, wheel_speed: np.ndarray) -> None:
        """Drive the wheels at speeds (2,) left, right [rad/s] for one control period.

        Raises:
            WorkError: MuJoCo gave a warning, as it also does when the state is no longer finite.
        """
        data = self.data
        data.ctrl[:] = wheel_speed
        self.advance(self._substeps)
        if data.warning.number.any():
            raise WorkError(f"physics failed at {data.time:.2f} s: {_name_warning(data)}")
        # After a step the sensors are one step behind the joints: evaluate them for the current state.
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_sensorPos(self.model, data)

    def advance(self, steps: int) -> None:
        """Let physics pass by so many of its time steps."""
        mujoco.mj_step(self.model, self.data, steps)

    def wheel_angle(self) -> np.ndarray:
        """Return wheel-joint angles (2,) left, right [rad], from the joint-position sensors."""
        sensor = self.data.sensordata
        return np.array((sensor[self._left], sensor[self._right]))

    def ranges(self, reach_m: float = REACH_M, turned_rad: float = 0.0) -> np.ndarray:
        """Return distances (K,) of the range rays [m], fan after fan; ``reach_m`` where nothing is nearer.

        Args:
            reach_m: Longest distance to measure [m].
            turned_rad: Direction of the fans: 0 straight ahead, positive to the left [rad].
        """
        x, y, yaw = self.pose()
        return self.ranges_at(np.array((x, y, yaw + turned_rad)), reach_m)

    def ranges_at(self, pose: np.ndarray, reach_m: float = REACH_M) -> np.ndarray:
        """Return distances (K,) of the range rays [m] of a robot at a pose (3,) x, y [m], yaw [rad]."""
        x, y, yaw = pose.tolist()
        return self._finder.measure(x, y, yaw, reach_m)

    def bumped(self) -> bool:
        """Whether something presses against the body or the mast."""
        return bool(self.data.sensordata[self._bumper] > 0.0)

    def time(self) -> float:
        """Return the time since the start [s]."""
        return self.data.time

    def snapshot(self) -> np.ndarray:
        """Return full positions (nq,), for the camera and the ground truth; the drive does not use them."""
        return self.data.qpos.copy()

    def pose(self) -> np.ndarray:
        """Return the true pose (3,): x, y [m], yaw [rad]."""
        x, y, _, w, i, j, k = self.data.qpos[:7].tolist()
        return np.array((x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))))

    def state(self) -> np.ndarray:
        """Return the full state of the simulation, on which all that follows depends, as one array."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def set_state(self, state: np.ndarray) -> None:
        """Restore a state exactly: the simulation continues bit for bit as it did from there."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        mujoco.mj_forward(self.model, self.data)
        # Evaluating the sensors may have touched the solver's warm start, which is part of the state.
        mujoco.mj_setState(self.model, self.data, state, _STATE)


def _settle(settings: SimSettings) -> np.ndarray:
    """Return full positions (nq,) of the robot at rest on a level floor at the origin, heading +x."""
    model = compile_scene(empty_room(), settings)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(_SETTLE_S / TIMESTEP_S))
    rest = data.qpos.copy()
    rest[:2], rest[6], rest[7:] = 0.0, 0.0, 0.0
    rest[3:7] /= np.linalg.norm(rest[3:7])
    return rest


def _name_warning(data: mujoco.MjData) -> str:
    names = [mujoco.mjtWarning(kind).name for kind in np.flatnonzero(data.warning.number).tolist()]
    return f"MuJoCo warned {', '.join(names)}"
