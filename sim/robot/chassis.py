"""A robot in a compiled scene, moved by physics: its state, its motors, wheel sensors and bumper, and its true pose.

Physics and image quality of the scene are the same whatever the room specifies.
"""

import math

import mujoco
import numpy as np

from sim.errors import InputError, WorkError, one_line, shorten
from sim.robot.model import BASE, CONTROL_PERIOD_S, TIMESTEP_S, WHEELS, Body, load_robot
from sim.robot.own import load_own_robot
from sim.rooms.deployment import dim
from sim.rooms.spec import NEAR_PLANE_M, ROBOT_PREFIX, empty_room, freeze
from sim.sensors.catalog import SENSORS, list_carried, load
from sim.settings import DeploymentSettings, SimSettings

AMBIENT_LIGHT = 0.4  # Brightness of the ambient light; a room without lamps of its own gets LAMPLESS_AMBIENT_LIGHT
LAMPLESS_AMBIENT_LIGHT = 0.9
FAR_PLANE_M = 60.0

# By default MuJoCo prints warnings and appends them to a file MUJOCO_LOG.TXT in the user's folder. The code that steps
# the physics reads warnings from the state instead, and a file that causes a warning is refused.
mujoco.set_mju_user_warning(lambda text: None)


def compile_scene(room: mujoco.MjSpec, settings: SimSettings) -> mujoco.MjModel:
    """Attach the robot to a copy of a room without moving parts, force physics and image quality, and compile.

    Raises InputError if the room and the robot do not fit together, as when both have parts of the same name.
    """
    spec = freeze(room)
    _force_physics(spec)
    _force_picture(spec)
    if settings.deployment != DeploymentSettings():
        dim(spec, settings.deployment)
    own = settings.robot.mjcf is not None
    robot = load_own_robot(settings.robot) if own else load_robot(settings.robot, settings.camera)
    for name in list_carried(settings):
        if mount := SENSORS[name].mount:
            load(mount)(robot, settings)
    robot.option = spec.option
    try:
        spec.attach(robot, prefix=ROBOT_PREFIX, frame=spec.worldbody.add_frame())
        return spec.compile()
    except ValueError as error:
        raise InputError(f"room: MuJoCo cannot put the robot into it: {one_line(error)}") from None


def _force_physics(spec: mujoco.MjSpec) -> None:
    spec.option = mujoco.MjSpec().option
    spec.option.timestep = TIMESTEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # A diverged state must be noticed, not silently reset to the start.
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _force_picture(spec: mujoco.MjSpec) -> None:
    # Coarse primitives, no oversampling and no shadows: geometry, not pixels, sets the cost of an image.
    quality = spec.visual.quality
    quality.numslices, quality.numstacks, quality.numquads = 12, 6, 1
    quality.offsamples, quality.shadowsize = 0, 0
    # A headlight that follows the view would leave seams between the faces of the fisheye.
    headlight = spec.visual.headlight
    headlight.active = 1
    shining = any(light.type != mujoco.mjtLightType.mjLIGHT_POINT for light in spec.lights)  # MuJoCo draws no others
    headlight.ambient = [AMBIENT_LIGHT if shining else LAMPLESS_AMBIENT_LIGHT] * 3
    headlight.diffuse = headlight.specular = [0.0] * 3
    # Clip planes scale with the extent, which is fixed so that they do not depend on the room's size.
    spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = NEAR_PLANE_M, FAR_PLANE_M


_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_SETTLING_S = 1.0
MIN_UPRIGHT_COSINE = 0.999  # Smallest cosine of the lean at which a user's own robot comes to rest
FLOOR_GAP_M, FALL_DEPTH_M = 0.01, 1.0
"""Largest height of its origin above the floor at rest, and depth below it from which a robot has fallen [m]."""
BUMPER_M = 0.005  # Height below which a user's own robot rolls over what it touches [m]


class Chassis:
    """A robot in a scene: the compiled ``model``, its state ``data`` and the dimensions of the robot's ``body``."""

    def __init__(self, settings: SimSettings, room: mujoco.MjSpec, body: Body) -> None:
        """Put the settings' robot of these dimensions into a room without moving parts, at rest."""
        self.settings, self.body = settings, body
        self.model = compile_scene(room, settings)
        self.data = mujoco.MjData(self.model)
        self._substeps = round(CONTROL_PERIOD_S / TIMESTEP_S)
        self._left, self._right = (self.model.sensor(ROBOT_PREFIX + name).adr[0] for name in WHEELS)
        self._bumper = self.model.sensor_adr[self.model.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH]
        own = settings.robot.mjcf is not None
        self._own = own & (self.model.body_rootid[self.model.geom_bodyid] == self.model.body(ROBOT_PREFIX + BASE).id)
        self._rest = _settle(settings)

    def place(self, pose: np.ndarray) -> None:
        """Place the robot at a pose (3,) x, y [m], yaw [rad], settled and at rest, with wheel angles zero."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.rest_states(np.asarray(pose)[None])[0]
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

        Raises WorkError if MuJoCo gave a warning, as it also does when the state is no longer finite, or if the robot
        fell through a hole in the floor.
        """
        data = self.data
        data.ctrl[:] = wheel_speed
        self.advance(self._substeps)
        if data.warning.number.any():
            names = [mujoco.mjtWarning(kind).name for kind in np.flatnonzero(data.warning.number).tolist()]
            raise WorkError(f"physics failed at {data.time:.2f} s: MuJoCo warned {', '.join(names)}")
        if data.qpos[2] < -FALL_DEPTH_M:
            raise WorkError(f"the robot fell through the room's floor at {data.time:.2f} s: the floor has a hole")
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

    def bumped(self) -> bool:
        """Whether something presses against the robot: its body, or any part of a user's own above ``BUMPER_M``."""
        data, force = self.data, np.empty(6)
        one, other = self._own[data.contact.geom].T
        for contact in np.flatnonzero((one != other) & (data.contact.pos[:, 2] > BUMPER_M)).tolist():
            mujoco.mj_contactForce(self.model, data, contact, force)
            if force[0] > 0.0:
                return True
        return bool((data.sensordata[self._bumper] > 0.0).any())

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
    mujoco.mj_step(model, data, round(_SETTLING_S / TIMESTEP_S))
    rest = data.qpos.copy()
    if settings.robot.mjcf is not None:
        what = f"robot.mjcf {shorten(settings.robot.mjcf, 300)}"
        if not 1.0 - 2.0 * (rest[4] ** 2 + rest[5] ** 2) >= MIN_UPRIGHT_COSINE:  # NaN is not
            raise InputError(
                f"{what}: it does not stay level on a level floor: a caster is missing, or at a wrong height"
            )
        if not abs(rest[2]) <= FLOOR_GAP_M:
            raise InputError(
                f"{what}: at rest, its body's origin is {rest[2]:.3g} m above the floor; at most {FLOOR_GAP_M:g} m is "
                "allowed"
            )
    rest[:2], rest[6] = 0.0, 0.0
    rest[[model.joint(ROBOT_PREFIX + name).qposadr[0] for name in WHEELS]] = 0.0  # springs stay as they settled
    rest[3:7] /= np.linalg.norm(rest[3:7])
    return rest
