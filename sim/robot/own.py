"""A user's own robot: an MJCF file, tried out as rooms are; its parts get the names of the testbed's own robot."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sim.errors import InputError, one_line, shorten
from sim.robot.model import BASE, CAMERA, CAMERA_SITE, WHEELS, Body
from sim.rooms.mjcf_files import read_model
from sim.settings import RobotSettings

_ANGLE = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
LEVEL = np.stack([np.cos(_ANGLE), np.sin(_ANGLE), np.zeros(len(_ANGLE))], axis=1)
ACROSS = LEVEL[:, [0, 2, 1]]
"""Directions (n, 3) that are level, and those across a wheel's axis."""


def find_reach(
    model: mujoco.MjModel, data: mujoco.MjData, direction: np.ndarray, joint: int | None = None
) -> np.ndarray:
    """How far the colliding geoms of a robot, or of a joint's wheel alone, reach in directions (n, 3) (n,) [m].

    How far a convex body reaches in a direction d is the largest product of its points with d.
    """
    geoms = (model.geom_contype | model.geom_conaffinity) > 0
    if joint is not None:
        geoms &= model.body_weldid[model.geom_bodyid] == model.body_weldid[model.jnt_bodyid[joint]]
    reach = [_support(model, data, geom, direction) for geom in np.flatnonzero(geoms).tolist()]
    return np.max([np.full(len(direction), -np.inf), *reach], axis=0)


def _support(model: mujoco.MjModel, data: mujoco.MjData, geom: int, direction: np.ndarray) -> np.ndarray:
    """How far a geom reaches in directions (n, 3) from the origin (n,) [m]."""
    along = direction @ data.geom_xmat[geom].reshape(3, 3)  # in the geom's own axes
    x, y, z = model.geom_size[geom]
    kind, across = model.geom_type[geom], np.hypot(along[:, 0], along[:, 1])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        reach = np.full(len(along), x)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        reach = x + y * np.abs(along[:, 2])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        reach = x * across + y * np.abs(along[:, 2])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        reach = np.linalg.norm(along * (x, y, z), axis=1)
    else:
        reach = np.abs(along) @ (x, y, z)
    return direction @ data.geom_xpos[geom] + reach


TOLERANCE_M = 0.001  # Wheels and camera may be this far from where they must be [m]
ROUND_TOLERANCE = 0.02  # Largest difference of a wheel's radii, as a part of them
PRIORITY = 2
UPWARD_ORIENTATION = (0.0, 0.5**0.5, 0.5**0.5, 0.0)  # Of the camera of dm_env: its axes are 0 1 0 and 1 0 0
_SERVO = ("gaintype", "gainprm", "biastype", "biasprm", "forcelimited", "forcerange", "ctrllimited", "ctrlrange")


def load_own_robot(robot: RobotSettings) -> mujoco.MjSpec:
    """Read a user's robot, with motors, wheel sensors, bumper and camera as the testbed's own robot has them.

    Raises InputError if the file is refused, or lacks a part; one line names the setting and what is needed.
    """
    spec = _read(robot)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    place = data.site(CAMERA_SITE).xpos - data.body(BASE).xpos  # of a site that may be in a part of the body
    # The camera that dm_env shows: it looks up, the top of its picture is ahead.
    spec.body(BASE).add_camera(name=CAMERA, pos=place, quat=UPWARD_ORIENTATION, fovy=90.0)
    return spec


def describe_own(robot: RobotSettings) -> Body:
    """Dimensions of a user's robot by its geoms; wheel radius and track are rough.

    Raises InputError as ``load_own_robot``, or if a wheel or the camera is not where it must be.
    """
    spec = _read(robot)
    try:
        model = spec.compile()
    except ValueError as error:
        raise _refuse(robot, f"MuJoCo cannot compile it: {shorten(one_line(error), 300)}") from None
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    left, right = (data.xanchor[model.joint(name).id] for name in WHEELS)
    axes = np.array([data.xaxis[model.joint(name).id] for name in WHEELS])
    if not np.allclose(axes, (0.0, 1.0, 0.0), atol=TOLERANCE_M):
        raise _refuse(robot, "both wheels' joints must have the axis 0 1 0, so that they turn forward")
    middle = (left + right) / 2
    if left[1] <= right[1] or np.abs([middle[0], middle[1], left[0] - right[0]]).max() > TOLERANCE_M:
        raise _refuse(
            robot, "its body's origin must be under the middle of its wheel axle, x forward, left wheel at y > 0"
        )
    camera = data.site(CAMERA_SITE)
    if (
        np.hypot(*camera.xpos[:2]) > TOLERANCE_M
        or camera.xmat[8] < 1.0 - TOLERANCE_M
        or camera.xmat[0] < 1.0 - TOLERANCE_M
    ):
        where = "above the middle of the axle, upright, its x axis forward; camera_mount moves and tilts it"
        raise _refuse(robot, f"robot.camera_site {shorten(robot.camera_site)} must be {where}")
    for name in WHEELS:
        joint = model.joint(name).id
        reach_m = find_reach(model, data, ACROSS, joint) - ACROSS @ data.xanchor[joint]
        if not 0.0 < reach_m.max() * (1.0 - ROUND_TOLERANCE) <= reach_m.min():
            figure = f"its radius is {1e3 * reach_m.min():.3g} to {1e3 * reach_m.max():.3g} mm"
            cause = 'is its euler in radians without angle="radian", or no geom that collides on its axis?'
            raise _refuse(robot, f"its {name.replace('_', ' ')} is not round about the axis, {figure}: {cause}")
    aside_m, up_m = (float(find_reach(model, data, direction).max()) for direction in (LEVEL, np.eye(3)[2:]))
    return Body(aside_m, max(up_m, float(camera.xpos[2])), float(middle[2]), float(left[1] - right[1]))


def _read(robot: RobotSettings) -> mujoco.MjSpec:
    """The robot under the testbed's names, without anything else that moves or measures, and without bumper."""
    spec, _ = read_model(Path(robot.mjcf or ""), "robot")
    bodies = list(spec.worldbody.bodies)
    if len(bodies) != 1:
        raise _refuse(robot, f"its world must hold one body, the robot, and holds {len(bodies)}")
    wheels = [_find(spec.joint, spec.joints, robot, name) for name in ("left_joint", "right_joint")]
    site = _find(spec.site, spec.sites, robot, "camera_site")
    if wheels[0].name == wheels[1].name:
        raise _refuse(robot, f"robot.right_joint {shorten(wheels[1].name)} is the left wheel's joint too")
    servos = [_find_servo(spec, robot, wheel.name) for wheel in wheels]
    world = spec.worldbody
    apart = [*world.geoms, *world.sites, *world.cameras, *world.lights, *(s for s in spec.sites if s.name != site.name)]
    for group in (spec.keys, spec.sensors, spec.actuators, spec.equalities, spec.tendons, spec.cameras, spec.lights):
        apart += [element for element in group if element not in apart]
    for element in apart:
        spec.delete(element)
    _rename(spec, bodies[0], wheels, site)
    for name, servo in zip(WHEELS, servos, strict=True):
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, **servo)
        spec.add_sensor(
            name=name, type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
        )
    for geom in spec.geoms:
        geom.priority, geom.margin, geom.gap = PRIORITY, 0.0, 0.0
    return spec


def _rename(spec: mujoco.MjSpec, body: Any, wheels: list[Any], site: Any) -> None:
    for exclude in spec.excludes:
        exclude.bodyname1, exclude.bodyname2 = (
            BASE if name == body.name else name for name in (exclude.bodyname1, exclude.bodyname2)
        )
    body.name, site.name = BASE, CAMERA_SITE
    body.pos = (0.0, 0.0, 0.0)
    free = [joint for joint in body.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if not free:
        free = [body.add_freejoint()]
    free[0].name = BASE
    for wheel, name in zip(wheels, WHEELS, strict=True):
        wheel.name = name


def _find(find: Any, among: Any, robot: RobotSettings, setting: str) -> Any:
    """The joint or site that a setting names; a joint must be a hinge."""
    name = getattr(robot, setting)
    found = find(name)
    if found is not None and (setting == "camera_site" or found.type == mujoco.mjtJoint.mjJNT_HINGE):
        return found
    kind = "site" if setting == "camera_site" else "hinge joint"
    names = [one.name for one in among if one.name and (kind == "site" or one.type == mujoco.mjtJoint.mjJNT_HINGE)]
    there = f"it has {shorten(', '.join(names), 200)}" if names else "it has none with a name"
    raise InputError(f"robot.{setting} {shorten(name)}: {shorten(str(robot.mjcf), 300)} has no such {kind}; {there}")


def _find_servo(spec: mujoco.MjSpec, robot: RobotSettings, joint: str) -> dict[str, Any]:
    """The properties of the velocity actuator that drives a joint."""
    for actuator in spec.actuators:
        if actuator.target == joint and actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT:
            kv, gear = actuator.gainprm[0], actuator.gear[0]
            if kv > 0.0 and actuator.biasprm[2] == -kv and actuator.biasprm[1] == 0.0:
                if gear != 1.0:
                    needed = "must be 1, with kv and forcerange those at the wheel"
                    raise _refuse(robot, f"the actuator of its joint {shorten(joint)} has gear {gear:g}: it {needed}")
                return {name: getattr(actuator, name) for name in _SERVO}
    raise _refuse(
        robot, f"no velocity actuator drives its joint {shorten(joint)}: <velocity joint=... kv=.../> is needed"
    )


def _refuse(robot: RobotSettings, reason: str) -> InputError:
    return InputError(f"robot.mjcf {shorten(str(robot.mjcf), 300)}: {reason}")
