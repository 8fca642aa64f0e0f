"""A user's own robot: an MJCF file, tried out as rooms are; its parts get the names of the testbed's own robot."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sim.errors import InputError, one_line, shorten
from sim.robot.model import BASE, BUMPER, CAMERA, CAMERA_SITE, WHEELS, Body
from sim.rooms.mjcf_files import list_files
from sim.rooms.spec import drop_claims
from sim.settings import RobotSettings

DIRECTIONS = 720


def reach_of_geoms(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, float]:
    """How far the colliding geoms of a robot at the origin reach aside from its axis, and up [m].

    How far a convex body reaches in a direction d is the largest product of its points with d; how far it reaches
    aside is the largest of these over all level directions.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    level = np.stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)], axis=1)
    aside_m = up_m = 0.0
    for geom in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist():
        aside_m = max(aside_m, float(_support(model, data, geom, level).max()))
        up_m = max(up_m, float(_support(model, data, geom, np.array([[0.0, 0.0, 1.0]])).max()))
    return aside_m, up_m


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
BUMPER_REACH_M = 0.045  # The bumper's sensor reaches this far beyond the body [m]
BUMPER_BOTTOM_M, BUMPER_TOP_M = 0.005, 2.0  # It begins above what rolls on the floor, and ends above any robot [m]
PRIORITY = 2
UPWARD_ORIENTATION = (0.0, 0.5**0.5, 0.5**0.5, 0.0)  # Of the camera of dm_env: its axes are 0 1 0 and 1 0 0
_SERVO = ("gaintype", "gainprm", "biastype", "biasprm", "forcelimited", "forcerange", "ctrllimited", "ctrlrange")


def load_own_robot(robot: RobotSettings) -> mujoco.MjSpec:
    """Read a user's robot, with motors, wheel sensors, bumper and camera as the testbed's own robot has them.

    Raises InputError if the file is refused, or lacks a part; one line names the setting and what is needed.
    """
    spec = _read(robot)
    _add_camera(spec)
    _add_bumpers(spec, describe_own(robot).radius_m + BUMPER_REACH_M)
    return spec


def _add_camera(spec: mujoco.MjSpec) -> None:
    """Add the camera that dm_env shows, as our robot has it: it looks up, the top of its picture is ahead."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    place = data.site(CAMERA_SITE).xpos - data.body(BASE).xpos  # of a site that may be in a part of the body
    spec.body(BASE).add_camera(name=CAMERA, pos=place, quat=UPWARD_ORIENTATION, fovy=90.0)


def _add_bumpers(spec: mujoco.MjSpec, radius_m: float) -> None:
    """Add a touch sensor around the robot to its body and to each that is fixed to it: one feels its own body alone."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base, middle = model.body(BASE).id, np.array([0.0, 0.0, (BUMPER_BOTTOM_M + BUMPER_TOP_M) / 2])
    size = (radius_m, BUMPER_TOP_M - middle[2], 0.0)
    fixed = [(body, body.id) for body in spec.bodies if model.body_weldid[body.id] == base]  # elements change the ids
    for number, (body, row) in enumerate(fixed):
        back, turn = data.xmat[row].reshape(3, 3).T, np.empty(4)
        mujoco.mju_mat2Quat(turn, back.ravel())
        name, place = f"{BUMPER}_{number}", back @ (data.xpos[base] + middle - data.xpos[row])
        cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
        body.add_site(name=name, type=cylinder, size=size, pos=place, quat=turn, group=4, rgba=(0, 0, 0, 0))
        spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TOUCH, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)


def describe_own(robot: RobotSettings) -> Body:
    """Dimensions of a user's robot by its geoms; wheel radius and track are rough.

    Raises InputError as ``load_own_robot``, or if a wheel or the camera is not where it must be.
    """
    try:
        model = _read(robot).compile()
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
    aside_m, up_m = reach_of_geoms(model, data)
    return Body(aside_m, max(up_m, float(camera.xpos[2])), float(middle[2]), float(left[1] - right[1]))


def _read(robot: RobotSettings) -> mujoco.MjSpec:
    """The robot under the testbed's names, without anything else that moves or measures, and without bumper."""
    path = Path(robot.mjcf or "")
    list_files(path, "robot")
    try:
        spec = mujoco.MjSpec.from_file(str(path.resolve()))
        drop_claims(spec)
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        raise _refuse(robot, f"MuJoCo cannot read it: {shorten(one_line(error), 400)}") from None
    if spec.meshes or spec.hfields or spec.skins or spec.textures:
        raise _refuse(robot, "a robot is made of primitive geoms in plain colours: meshes and textures are not read")
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
