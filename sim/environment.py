"""The room as a ``dm_env.Environment``: wheel speeds in; polar image, encoder ticks and ranges out.

It runs on dm_control's ``Physics`` over the compiled room, so dm_control's tools (named access, cameras, its viewer)
see the same state. There is no task: the reward is always zero. Call ``sim.sensors.camera.gl.choose_backend`` before
this module is imported.

What a robot cannot sense is in attributes apart from the observations: ``true_pose`` and ``wheel_angle``. Encoder
faults that are drawn for a complete drive are applied to its wheel angles afterwards, by
``sim.sensors.encoder.read_encoders``.
"""

import mujoco
import numpy as np

from sim.errors import InputError, WorkError
from sim.geometry import planar_pose
from sim.robot.model import CONTROL_PERIOD_S, WHEELS
from sim.robot.range_finder import REACH_M
from sim.robot.world import RoomWorld
from sim.rooms.spec import ROBOT_PREFIX
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.gl import choose_backend
from sim.sensors.encoder import Constants, count_ticks, describe_odometry, scale_wheels
from sim.settings import NO_FAULTS, SimSettings

try:
    import dm_env
    from dm_env import specs
except ModuleNotFoundError:
    raise WorkError(
        "sim.environment needs dm-control, which has no wheels for this Python: use Python 3.11 or 3.12 "
        "and pip install dm-control"
    ) from None

_DRAWN_FAULTS = ("slip_per_m", "step_noise", "dropout", "stuck_fraction")


class RoomEnvironment(dm_env.Environment):
    """A robot in a room; an episode starts at a random reachable place, which ``rng`` draws.

    It ends after ``episode_s`` [s] with discount 1, as it is truncated, not terminated. The wheels keep their speed
    during a step of ``step_s`` [s], a multiple of the control period, 0.04 s. ``physics`` is dm_control's view of the
    model and its state, ``odometry`` what is known of the wheels, as in a recording's manifest. Raises InputError if
    the encoder has faults that are drawn for a complete drive (slip, noise of the gaps, lost readings, a stuck encoder,
    those of plugins), the camera has any faults, or a length is impossible; WorkError if no OpenGL context can be
    opened, or physics fails.
    """

    def __init__(
        self,
        settings: SimSettings,
        rng: np.random.Generator,
        episode_s: float = 60.0,
        step_s: float = CONTROL_PERIOD_S,
    ) -> None:
        drawn = {name: getattr(settings.encoder, name) for name in _DRAWN_FAULTS}
        drawn |= {f"plugins.{name}": strength for name, strength in settings.encoder.plugins.items()}
        for fault, value in drawn.items():
            if value != 0.0:
                raise InputError(
                    f"encoder.{fault} {value} must be 0 in the environment: it is drawn for a complete drive, by "
                    "sim.sensors.encoder.read_encoders from the wheel angles of environment.wheel_angle()"
                )
        if faults := [name for name, off in NO_FAULTS.items() if getattr(settings, name) != off]:
            raise InputError(f"{faults[0]} must keep its default: the environment's camera has no faults")
        self._periods = round(step_s / CONTROL_PERIOD_S) if np.isfinite(step_s) else 0
        if self._periods < 1 or abs(self._periods * CONTROL_PERIOD_S - step_s) > 1e-9:
            raise InputError(f"step_s {step_s} must be a multiple of the control period, {CONTROL_PERIOD_S} s")
        if not step_s <= episode_s < np.inf:  # NaN is not
            raise InputError(f"episode_s {episode_s} must be at least the length of a step, {step_s} s, and finite")
        choose_backend()
        from dm_control.mujoco import Physics, wrapper

        self._settings, self._rng = settings, rng
        self._world = RoomWorld(settings)
        self.physics = Physics.from_model(wrapper.MjModel(self._world.model))
        self._world.data = self.physics.data.ptr
        self._fisheye = Fisheye(self._world.model, settings.camera)
        self.odometry: Constants = describe_odometry(
            settings.encoder, self._world.body.wheel_radius_m, self._world.body.track_m
        )
        self._steps = round(episode_s / step_s)
        self._step: int | None = None

    def reset(self) -> dm_env.TimeStep:
        """Place the robot, settled, at a random reachable position with a random heading."""
        place = self._rng.choice(self._world.free_space.places())
        self._world.place(np.array([*place, self._rng.uniform(-np.pi, np.pi)]))
        self._step = 0
        return dm_env.restart(self._observe())

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """Drive the wheels at speeds (2,) left, right [rad/s] for the length of a step."""
        if self._step is None:
            return self.reset()
        for _ in range(self._periods):
            self._world.step(np.asarray(action, float))
        self._step += 1
        if self._step >= self._steps:
            self._step = None
            return dm_env.truncation(0.0, self._observe())
        return dm_env.transition(0.0, self._observe())

    def action_spec(self) -> specs.BoundedArray:
        """Wheel speeds (2,) left, right within the motors' limits, if they have any [rad/s]."""
        motors = [self._world.model.actuator(ROBOT_PREFIX + wheel) for wheel in WHEELS]
        limits = np.array([one.ctrlrange if one.ctrllimited[0] else (-np.inf, np.inf) for one in motors])
        return specs.BoundedArray((2,), np.float64, limits[:, 0], limits[:, 1], "wheel_speed")

    def observation_spec(self) -> dict[str, specs.Array]:
        """``polar`` image, cumulative ``ticks`` left and right, forward ``ranges`` [m]."""
        camera = self._settings.camera
        return {
            "polar": specs.BoundedArray((camera.rings, camera.sectors, 3), np.uint8, 0, 255, "polar"),
            "ticks": specs.Array((2,), np.int64, "ticks"),
            "ranges": specs.BoundedArray(self._world.ranges().shape, np.float64, 0.0, REACH_M, "ranges"),
        }

    def true_pose(self) -> np.ndarray:
        """True pose (3,) of the robot: x, y [m], yaw [rad]; for evaluation, as no robot can sense it."""
        return planar_pose(self._world.data.qpos)

    def wheel_angle(self) -> np.ndarray:
        """True angles (2,) of the wheel joints since the episode began: left, right [rad], without any fault."""
        return self._world.wheel_angle()

    def close(self) -> None:
        """Free the OpenGL context and the physics."""
        self._fisheye.close()
        self.physics.free()

    def _observe(self) -> dict[str, np.ndarray]:
        mujoco.mj_kinematics(self._world.model, self._world.data)
        encoder = self._settings.encoder
        since_start = np.stack([np.zeros(2), self._world.wheel_angle()])  # an episode starts at wheel angle zero
        angle = scale_wheels(since_start, encoder.radius_error_left, encoder.radius_error_right)[1]
        return {
            "polar": self._fisheye.polar(self._world.data),
            "ticks": count_ticks(angle, encoder),
            "ranges": np.minimum(self._world.ranges(), REACH_M),
        }
