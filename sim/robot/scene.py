"""The scene: a room with the robot in it. Physics and image quality are the same whatever the room specifies."""

import mujoco

from sim.errors import InputError, one_line
from sim.robot.model import TIMESTEP_S, load_robot
from sim.robot.own import load_own_robot
from sim.rooms.deployment import dim
from sim.rooms.spec import NEAR_M, PREFIX, freeze
from sim.sensors.catalog import SENSORS, list_carried, load
from sim.settings import DeploymentSettings, SimSettings

AMBIENT = 0.4
"""Brightness of the ambient light; a room without lamps of its own gets AMBIENT_WITHOUT_LAMPS."""
AMBIENT_WITHOUT_LAMPS = 0.9
FAR_M = 60.0

# By default MuJoCo prints warnings and appends them to a file MUJOCO_LOG.TXT in the user's folder. The code that steps
# the physics reads warnings from the state instead, and a file that causes a warning is refused.
mujoco.set_mju_user_warning(lambda text: None)


def compile_scene(room: mujoco.MjSpec, settings: SimSettings) -> mujoco.MjModel:
    """Attach the robot to a copy of a room, force physics and image quality, and compile.

    Args:
        room: The room, without moving parts; not modified.
        settings: Wheel error, camera height, sensors to mount and the light in use are used.

    Raises:
        InputError: The room and the robot do not fit together, for instance because both have parts of the same name.
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
        spec.attach(robot, prefix=PREFIX, frame=spec.worldbody.add_frame())
        return spec.compile()
    except ValueError as error:
        raise InputError(f"room: MuJoCo cannot put the robot into it: {one_line(error)}") from None


def _force_physics(spec: mujoco.MjSpec) -> None:
    defaults = mujoco.MjSpec()
    spec.option = defaults.option
    spec.option.timestep = TIMESTEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # A diverged state must be noticed, not silently reset to the start.
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET
    spec.memory = defaults.memory


def _force_picture(spec: mujoco.MjSpec) -> None:
    # Coarse primitives, no oversampling and no shadows: geometry, not pixels, sets the cost of an image.
    quality = spec.visual.quality
    quality.numslices, quality.numstacks, quality.numquads = 12, 6, 1
    quality.offsamples, quality.shadowsize = 0, 0
    # A headlight that follows the view would leave seams between the faces of the fisheye.
    headlight = spec.visual.headlight
    headlight.active = 1
    shining = any(light.type != mujoco.mjtLightType.mjLIGHT_POINT for light in spec.lights)  # MuJoCo draws no others
    headlight.ambient = [AMBIENT if shining else AMBIENT_WITHOUT_LAMPS] * 3
    headlight.diffuse = headlight.specular = [0.0] * 3
    # Clip planes scale with the extent, which is fixed so that they do not depend on the room's size.
    spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = NEAR_M, FAR_M
