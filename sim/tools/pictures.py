"""Fisheye pictures for people: round, and larger than those that a robot learns from."""

import mujoco
import numpy as np

from sim.robot.world import RoomWorld
from sim.sensors.camera.fisheye import Fisheye
from sim.settings import DeploymentSettings, SimSettings

SIZE_PX = 512


def draw_round(settings: SimSettings, poses: np.ndarray, size_px: int = SIZE_PX) -> np.ndarray:
    """Draw what the robot sees at rest at poses (n, 3) x, y [m], yaw [rad], in the room as it is in training.

    Returns:
        Round pictures (n, size_px, size_px, 3) uint8 RGB, black outside the rim.

    Raises:
        InputError: The room cannot be built.
        WorkError: No OpenGL context can be opened.
    """
    world = RoomWorld(settings.model_copy(update={"deployment": DeploymentSettings()}))
    pictures = np.empty((len(poses), size_px, size_px, 3), np.uint8)
    with Fisheye(world.model, settings.camera.model_copy(update={"face_px": size_px // 2})) as camera:
        for picture, state in zip(pictures, world.rest_states(poses), strict=True):
            world.data.qpos[:] = state
            mujoco.mj_kinematics(world.model, world.data)
            picture[:] = camera.round(world.data, size_px)
    return pictures
