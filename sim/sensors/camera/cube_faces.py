"""The pinhole faces that together cover the fisheye's view: five sides of a cube, cut to the lens's cone.

Each face is an off-centre pinhole: of the four upright sides only the part above the cone's rim is drawn. Cutting
them this way, and drawing in each face only the geoms that reach into it, costs no more than three wide faces and
gives a much more even resolution.
"""

from dataclasses import dataclass

import numpy as np

from sim.sensors.camera.lens import Lens

_MARGIN_PX = 1  # bilinear sampling at a face's edge reads half a pixel beyond it


@dataclass(frozen=True)
class Face:
    """One pinhole picture and its place in the strip of all of them.

    Attributes:
        axes: Rows right, up, forward in the camera's frame (3, 3).
        window: Tangents of the angles of its edges: left, right, bottom, top (4,).
        column: First column in the strip [px].
        width: Width [px].
        height: Height [px].
    """

    axes: np.ndarray
    window: np.ndarray
    column: int
    width: int
    height: int


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
    normals = [
        [
            face.axes[0] - face.window[0] * face.axes[2],
            face.window[1] * face.axes[2] - face.axes[0],
            face.axes[1] - face.window[2] * face.axes[2],
            face.window[3] * face.axes[2] - face.axes[1],
        ]
        for face in faces
    ]
    planes = np.array(normals)
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
