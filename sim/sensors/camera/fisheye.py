"""The fisheye image: pinhole faces drawn by MuJoCo and mapped to the lens's image by one ``cv2.remap``.

MuJoCo has no fisheye projection. The faces are five sides of a cube, of which the four upright ones are cut to the
lens's cone. On a CPU the cost of a face is that of its geoms, so each face draws only those that reach into it. An
image must not depend on the face in which something is drawn: there are no shadows, and no light turns with the view.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from sim.rooms.spec import ROBOT_PREFIX
from sim.sensors.camera.lens import Lens, make_lens, polar_rays, round_rays
from sim.sensors.camera.mount import CIRCLE_PX, tilt
from sim.sensors.camera.occlusion import Occlusion
from sim.sensors.camera.offscreen import INVISIBLE_GEOM, Face, Offscreen, aim, make_scene, update_scene
from sim.settings import CameraMountSettings, CameraSettings

_MARGIN_PX = 1  # bilinear sampling at a face's edge reads half a pixel beyond it


def make_faces(lens: Lens, face_px: int) -> list[Face]:
    """Make the faces that cover the lens's cone; a full side of the cube has ``face_px`` pixels of size 2 / face_px."""
    faces: list[Face] = []
    for forward, up, window in _cut_cube(lens.half_angle):
        left, right, bottom, top = window
        width = int(np.ceil((right - left) * face_px / 2)) + 2 * _MARGIN_PX
        height = int(np.ceil((top - bottom) * face_px / 2)) + 2 * _MARGIN_PX
        first = np.array([left, bottom]) - _MARGIN_PX * 2 / face_px
        last = first + np.array([width, height]) * 2 / face_px
        column = faces[-1].column + faces[-1].width if faces else 0
        axes = np.array([np.cross(forward, up), up, forward])
        faces.append(Face(axes, np.array([first[0], last[0], first[1], last[1]]), column, width, height))
    return faces


def map_rays(faces: list[Face], rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map rays (..., 3) to column and row [px] float32 in the strip, whose first row is the lowest.

    Pixel centres are integers; a ray that is NaN maps far outside the strip.
    """
    owner = np.argmax(np.stack([rays @ face.axes[2] for face in faces]), axis=0)
    column, row = np.empty(rays.shape[:-1], np.float32), np.empty(rays.shape[:-1], np.float32)
    for index, face in enumerate(faces):
        mine = owner == index
        right, up, forward = np.moveaxis(rays[mine] @ face.axes.T, -1, 0)
        left_edge, right_edge, bottom_edge, top_edge = face.window
        across, along = (right / forward - left_edge), (up / forward - bottom_edge)
        column[mine] = face.column + across * face.width / (right_edge - left_edge) - 0.5
        row[mine] = along * face.height / (top_edge - bottom_edge) - 0.5
    outside = np.isnan(rays).any(axis=-1)
    column[outside] = row[outside] = -10.0
    return column, row


def edge_planes(faces: list[Face]) -> np.ndarray:
    """Inward unit normals of each face's four edge planes, in the camera's frame (faces, 4, 3)."""
    planes = np.array(
        [
            [right - first * ahead, last * ahead - right, up - bottom * ahead, top * ahead - up]
            for (right, up, ahead), (first, last, bottom, top) in ((face.axes, face.window) for face in faces)
        ]
    )
    return planes / np.linalg.norm(planes, axis=-1, keepdims=True)


def _cut_cube(half_angle: float) -> list[tuple[np.ndarray, np.ndarray, tuple[float, float, float, float]]]:
    """Forward, up and window of the cube's top and, where the cone reaches them, of its four sides."""
    x, y, z = np.eye(3)
    across = np.tan(min(half_angle, np.pi / 4))
    top = [(z, x, (-across, across, -across, across))]
    if half_angle <= np.pi / 4:
        return top
    # a rim below the horizon is lowest in a side's corners, a rim above it in the side's middle
    rim = np.tan(np.pi / 2 - half_angle)
    bottom = rim * np.sqrt(2.0) if rim < 0 else rim
    return top + [(forward, z, (-1.0, 1.0, bottom, 1.0)) for forward in (x, y, -x, -y)]


CAMERA_SITE = f"{ROBOT_PREFIX}camera"
AXLE_MOUNT = CameraMountSettings()
# Points read per face pixel along each axis: more points cost time without a measurable gain.
_READ_DENSITY = 1.0
HIDDEN_GROUP = 5  # Group of geoms that no camera sees
Dress = Callable[[mujoco.MjvScene], None]
"""Changes a scene before it is drawn: its lights, or what is in it besides the model."""


@dataclass(frozen=True)
class _Warp:
    """Fixed-point maps from the strip of faces to a finer image, which is averaged to ``shape`` rows and columns."""

    column_row: np.ndarray
    fraction: np.ndarray
    shape: tuple[int, int]


class Fisheye(Offscreen):
    """The upward camera of one model; opens an OpenGL context, which belongs to the thread that opened it.

    Its optical axis is the z axis of the site ``robot/camera`` and azimuth zero its x axis. The robot's own geoms are
    not drawn: none of them is above the lens. The mount says where the camera and its optical centre are; leans are
    given with each image. Raises InputError if the lens is impossible, WorkError if no OpenGL context can be opened.
    """

    def __init__(self, model: mujoco.MjModel, camera: CameraSettings, mount: CameraMountSettings = AXLE_MOUNT) -> None:
        self._model, self._camera = model, camera
        self._offset = np.array([mount.ahead_m, mount.left_m, 0.0])
        self._lens = make_lens(camera)
        self._faces = make_faces(self._lens, camera.face_px)
        self._planes = edge_planes(self._faces)
        self._site = model.site(CAMERA_SITE).id
        self._robot = np.array([model.body(body).name.startswith(ROBOT_PREFIX) for body in model.geom_bodyid])
        self._boxes = _local_boxes(model)
        self._occlusion = Occlusion(model)
        self._scene, self._option, self._view = make_scene(model)
        finer = self._finer(self._lens.half_angle / camera.rings)
        self._centre = 2.0 * mount.centre_px / CIRCLE_PX
        rays = polar_rays(self._lens, camera.rings * finer, camera.sectors * finer, self._centre)
        self._polar = self._make_warp(rays, finer)
        self._round: dict[int, _Warp] = {}
        last, height = self._faces[-1], max(face.height for face in self._faces)
        super().__init__(model, last.column + last.width, height)

    def polar(self, data: mujoco.MjData, lean: np.ndarray | None = None, dress: Dress | None = None) -> np.ndarray:
        """The polar image of a state with kinematics computed: (rings, sectors, 3) uint8 RGB.

        The camera leans about its own centre, to the robot's right and forward (2,) [rad]; ``dress`` changes the scene
        first, and what it adds is drawn in every face.
        """
        return _warp(self._draw(data, lean, dress), self._polar)

    def round(
        self, data: mujoco.MjData, size_px: int, lean: np.ndarray | None = None, dress: Dress | None = None
    ) -> np.ndarray:
        """The round picture of the state ``data``: (size_px, size_px, 3) uint8 RGB, black outside the rim."""
        if size_px not in self._round:
            finer = self._finer(2 * self._lens.half_angle / size_px)
            self._round[size_px] = self._make_warp(round_rays(self._lens, size_px * finer, self._centre), finer)
        return _warp(self._draw(data, lean, dress), self._round[size_px])

    def _finer(self, pitch_rad: float) -> int:
        """Factor by which the faces are read finer than the image, so that each of their pixels counts."""
        return int(np.clip(np.ceil(_READ_DENSITY * pitch_rad * self._camera.face_px / 2), 1, 8))

    def _make_warp(self, rays: np.ndarray, finer: int) -> _Warp:
        column, row = map_rays(self._faces, rays)
        column_row, fraction = cv2.convertMaps(column, row, cv2.CV_16SC2)
        return _Warp(column_row, fraction, (column.shape[0] // finer, column.shape[1] // finer))

    def _draw(self, data: mujoco.MjData, lean: np.ndarray | None, dress: Dress | None) -> np.ndarray:
        """Draw all faces; the strip's first row is the lowest."""
        self.begin()
        scene = self._scene
        turn = data.site_xmat[self._site].reshape(3, 3)
        position = data.site_xpos[self._site] + turn @ self._offset
        if lean is not None:
            turn = turn @ tilt(lean)
        hidden, group = self._occlusion.find_hidden(position), self._model.geom_group.copy()
        self._model.geom_group[hidden] = HIDDEN_GROUP
        update_scene(self._model, data, self._option, self._view, scene)
        self._model.geom_group[:] = group
        modelled = np.array([geom.objid for geom in scene.geoms[: scene.ngeom]], int)
        seen = self._find_seen(data, modelled, position, turn)
        if dress is not None:
            dress(scene)
        geoms = scene.geoms[: scene.ngeom]
        seen = np.pad(seen, [(0, 0), (0, len(geoms) - len(modelled))], constant_values=True)
        kinds = [geom.type for geom in geoms]
        shown = np.ones(len(geoms), bool)
        for face, wanted in zip(self._faces, seen, strict=True):
            for index in np.flatnonzero(wanted != shown):
                geoms[index].type = kinds[index] if wanted[index] else INVISIBLE_GEOM
            shown = wanted
            aim(scene, face, position, turn)
            mujoco.mjr_render(mujoco.MjrRect(face.column, 0, face.width, face.height), scene, self.target)
        return self.read()

    def _find_seen(self, data: mujoco.MjData, geoms: np.ndarray, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Mask (faces, geoms) of the geoms whose boxes reach into each face's pyramid, by its four planes.

        ``position`` (3,) is the camera's, ``turn`` (3, 3) holds its axes as columns.
        """
        middle, half = self._boxes[0][geoms], self._boxes[1][geoms]
        axes = data.geom_xmat[geoms].reshape(-1, 3, 3)
        place = data.geom_xpos[geoms] - position + np.einsum("gij,gj->gi", axes, middle)
        planes = self._planes.reshape(-1, 3) @ turn.T
        edges = (axes * half[:, None, :]).transpose(1, 0, 2).reshape(3, -1)  # half edges as columns, three per geom
        reach = np.abs(planes @ edges).reshape(len(planes), -1, 3).sum(axis=-1)
        inside = (planes @ place.T + reach > 0).reshape(len(self._faces), 4, -1).all(axis=1)
        return inside & ~self._robot[geoms]


def _local_boxes(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half edges of each geom's box in its own frame; an infinite plane has a very large box."""
    middle, half = model.geom_aabb[:, :3].copy(), model.geom_aabb[:, 3:].copy()
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    size = model.geom_size[plane, :2]
    middle[plane] = 0.0
    half[plane, :2] = np.where(size > 0, size, 1e6)
    half[plane, 2] = 0.0
    return middle, half


def _warp(strip: np.ndarray, warp: _Warp) -> np.ndarray:
    fine = cv2.remap(strip, warp.column_row, warp.fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    rows, columns = warp.shape
    return cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA)
