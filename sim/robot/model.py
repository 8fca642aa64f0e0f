"""The robot: its model, dimensions and kinematics. assets/robot/README.md gives the source of each figure."""

from dataclasses import dataclass

import mujoco
import numpy as np

from sim.files import ROBOT
from sim.settings import CameraSettings, RobotSettings

BASE = "base"
WHEELS = ("left_wheel", "right_wheel")
CAMERA_SITE = "camera"
CAMERA = "fisheye"
TIMESTEP_S, CONTROL_PERIOD_S = 0.005, 0.04
"""Time step of the physics, and period of the controller, an integer multiple of the time step [s]."""

RADIUS_M = 0.105
"""Radius of the round body around the middle of the wheel axle [m] (OpenCR turtlebot3_burger.h: ROBOT_RADIUS)."""
BODY_HEIGHT_M = 0.19  # Top of the body, where the mast begins [m] (e-Manual: 192 mm)
WHEEL_RADIUS_M = 0.03299
"""Effective wheel radius [m]: distance travelled over mean wheel angle, from sim.robot.calibrate (nominal 0.033)."""
TRACK_M = 0.16
"""Effective track [m]: difference of the wheels' distances over the angle turned, from sim.robot.calibrate
(nominal 0.160)."""

_LENS_M = CameraSettings().height_m  # as in robot.xml


@dataclass(frozen=True)
class Body:
    """Dimensions of a robot."""

    radius_m: float  # Radius of a round body around the middle of the wheel axle, in which the robot fits [m]
    height_m: float  # Its full height, floor to lens or body, whichever is higher [m]
    wheel_radius_m: float  # Effective wheel radius [m]
    track_m: float  # Effective track [m]


def describe_body(camera: CameraSettings) -> Body:
    """Dimensions of the testbed's own robot."""
    return Body(RADIUS_M, max(camera.height_m, BODY_HEIGHT_M), WHEEL_RADIUS_M, TRACK_M)


BURGER = describe_body(CameraSettings())


def load_robot(robot: RobotSettings, camera: CameraSettings) -> mujoco.MjSpec:
    """Read the robot's model and fit it to the settings: the left wheel's radius, the camera's height."""
    spec = mujoco.MjSpec.from_file(str(ROBOT / "robot.xml"))
    if robot.wheel_radius_error != 0.0:
        _scale_left_wheel(spec, 1.0 + robot.wheel_radius_error)
    if camera.height_m != _LENS_M:
        _raise_lens(spec, camera.height_m)
    return spec


def wheel_speeds(speed_mps: float, turn_rate_rps: float, body: Body = BURGER) -> np.ndarray:
    """Return wheel speeds (2,) left, right [rad/s] for a speed and a turn rate: (v -+ omega track / 2) / radius."""
    half = turn_rate_rps * body.track_m / 2
    return np.array([(speed_mps - half) / body.wheel_radius_m, (speed_mps + half) / body.wheel_radius_m])


def wheel_motion(wheel_angle: np.ndarray, body: Body) -> tuple[float, float]:
    """Return how far the robot drives [m] and turns to the left [rad] as its wheels turn by (2,) left, right [rad]."""
    left, right = wheel_angle.tolist()
    return (left + right) / 2 * body.wheel_radius_m, (right - left) * body.wheel_radius_m / body.track_m


def _scale_left_wheel(spec: mujoco.MjSpec, factor: float) -> None:
    """Scale the left wheel about its own axle, which is raised or lowered with it so that the body stays level."""
    wheel = spec.body("left_wheel")
    wheel.pos[2] *= factor
    for geom in wheel.geoms:
        is_cylinder = geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER  # of radius and half length
        geom.size = geom.size * (factor, 1.0, 1.0 if is_cylinder else factor)


def _raise_lens(spec: mujoco.MjSpec, lens_m: float) -> None:
    """Move the lens to a height [m] and stretch the mast below it."""
    rise = lens_m - _LENS_M
    spec.site(CAMERA_SITE).pos[2] = lens_m
    spec.camera(CAMERA).pos[2] = lens_m
    for name in ("mast_head", "lens"):
        spec.geom(name).pos[2] += rise
    for name in ("mast_visual", "mast"):
        mast = spec.geom(name)
        bottom = mast.pos[2] - mast.size[1]
        half = max(mast.size[1] + rise / 2, 0.001)
        mast.size[1], mast.pos[2] = half, bottom + half
