"""The tag camera: a horizontal pinhole camera on the robot, drawn in grey by MuJoCo.

Its frame is OpenCV's: x to the right, y down, z ahead. The principal point is the image centre; there is no distortion.
"""

from collections.abc import Callable

import cv2
import mujoco
import numpy as np

from sim.rooms.spec import ROBOT_PREFIX
from sim.sensors.camera.offscreen import INVISIBLE_GEOM, Face, Offscreen, aim, make_scene, update_scene
from sim.sensors.catalog import Opened
from sim.settings import SimSettings, TagCameraSettings

NAME = "tag_camera"
FIELD_OF_VIEW_DEG = 100.0  # Full angle across the image [deg]
HEIGHT_M, FORWARD_OFFSET_M = 0.28, -0.04  # Place of its middle, above the floor and in front of the wheel axle [m]
YAW_DEG = 180.0  # Direction of view, left of straight ahead [deg]: backwards, as the robot stops at obstacles
CAMERA_TO_MOUNT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from the camera's frame to its mount's, whose x axis points out and z up: right is -y, down -z, ahead x."""


class TagCamera(Offscreen):
    """The tag camera of one model; opens an OpenGL context, which belongs to the thread that opened it.

    The robot itself is not drawn. At its site, the x axis points out and the z axis up. Raises WorkError if no OpenGL
    context can be opened; the message names the fix.
    """

    def __init__(self, model: mujoco.MjModel, settings: TagCameraSettings) -> None:
        self._model, self._site = model, model.site(ROBOT_PREFIX + NAME).id
        self._robot = np.array([model.body(body).name.startswith(ROBOT_PREFIX) for body in model.geom_bodyid])
        self._scene, self._option, self._view = make_scene(model)
        across = np.tan(np.radians(FIELD_OF_VIEW_DEG) / 2)
        up = across * settings.height_px / settings.width_px
        window = np.array([-across, across, -up, up])
        self._face = Face(CAMERA_TO_MOUNT.T * [[1.0], [-1.0], [1.0]], window, 0, settings.width_px, settings.height_px)
        super().__init__(model, settings.width_px, settings.height_px)

    def look(self, data: mujoco.MjData) -> np.ndarray:
        """The image of the state ``data``: (height_px, width_px) uint8, grey."""
        self.begin()
        scene, face = self._scene, self._face
        update_scene(self._model, data, self._option, self._view, scene)
        for geom in scene.geoms[: scene.ngeom]:
            if self._robot[geom.objid]:
                geom.type = INVISIBLE_GEOM
        aim(scene, face, data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3))
        mujoco.mjr_render(mujoco.MjrRect(0, 0, face.width, face.height), scene, self.target)
        return cv2.cvtColor(np.ascontiguousarray(self.read()[::-1]), cv2.COLOR_RGB2GRAY)


def open_tag_camera(settings: SimSettings, scene: Callable[[], mujoco.MjModel]) -> Opened:
    """Open the tag camera in the scene."""
    model = scene()
    camera, data = TagCamera(model, settings.tag_camera), mujoco.MjData(model)

    def sense(state: np.ndarray, lean: np.ndarray | None) -> np.ndarray:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        return camera.look(data)

    return Opened(sense, camera.renderer_string)


def mount(robot: mujoco.MjSpec, settings: SimSettings) -> None:
    """Put the tag camera on the robot: a small massless box, and a site whose x axis points outwards and z axis up."""
    base = robot.body("base")
    place, half = (FORWARD_OFFSET_M, 0.0, HEIGHT_M), np.radians(YAW_DEG) / 2
    base.add_site(name=NAME, pos=place, quat=(np.cos(half), 0.0, 0.0, np.sin(half)), size=[0.004] * 3, group=4)
    base.add_geom(
        name=NAME,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=place,
        size=(0.012, 0.02, 0.012),
        material="shell" if robot.material("shell") is not None else "",
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=2,
    )


def camera_matrix(settings: TagCameraSettings) -> np.ndarray:
    """Intrinsic matrix (3, 3) [px], with pixel centres at integers."""
    focal = settings.width_px / 2 / np.tan(np.radians(FIELD_OF_VIEW_DEG) / 2)
    middle = (settings.width_px - 1) / 2, (settings.height_px - 1) / 2
    return np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])


def mounting() -> np.ndarray:
    """The camera's pose in the robot's frame (4, 4)."""
    yaw = np.radians(YAW_DEG)
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ CAMERA_TO_MOUNT
    pose[:3, 3] = FORWARD_OFFSET_M, 0.0, HEIGHT_M
    return pose
