"""What a viewer shows of a run in addition to its arrays: the open room, the floor plan, round pictures, colours."""

from pathlib import Path

import cv2
import numpy as np
import trimesh
from matplotlib.colors import hsv_to_rgb, to_rgb

from deepgps.reports.style import SCREEN
from sim.errors import InputError
from sim.occupancy import FreeSpace, limits
from sim.sensors.camera.lens import make_lens, project_polar, round_rays
from sim.settings import CameraSettings

JPEG_QUALITY = 85


def open_room(scene: Path, space: FreeSpace) -> bytes:
    """The room's mesh as GLB, open to view: without its south wall and the objects in its upper quarter."""
    try:
        loaded = trimesh.load_scene(scene)
    except Exception as error:  # trimesh passes on whatever its readers raise
        raise InputError(f"{scene} cannot be read: {error}") from None
    roof, south = 0.75 * loaded.bounds[1, 2], limits(space, margin_m=0.0)[0][1]
    hidden = []
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        corners = trimesh.transform_points(trimesh.bounds.corners(loaded.geometry[name].bounds), transform)
        low, high = corners.min(axis=0), corners.max(axis=0)
        in_south_wall = high[1] < south and high[2] > 0.1
        on_south_wall = high[1] < south + 0.25 and low[2] > 0.05
        if low[2] > roof or in_south_wall or on_south_wall:
            hidden.append(name)
    loaded.delete_geometry(hidden)
    glb = loaded.export(file_type="glb")
    assert isinstance(glb, bytes)
    return glb


def draw_floor_plan(space: FreeSpace) -> tuple[np.ndarray, np.ndarray]:
    """Picture of the floor (rows, columns, 3) uint8, southern row first, and its south-west corner (2,) [m]."""
    palette = [to_rgb(colour) for colour in SCREEN]
    kind = np.where(space.reachable, 0, np.where(space.free, 1, 2))
    cells = (np.stack(limits(space, margin_m=0.1)) - space.origin) / space.cell_m
    low, high = np.maximum(np.rint(cells[0]).astype(int), 0), np.rint(cells[1]).astype(int) + 1
    picture = (np.array(palette) * 255).astype(np.uint8)[kind[low[1] : high[1], low[0] : high[0]]]
    return np.ascontiguousarray(picture), space.origin + (low - 0.5) * space.cell_m


def find_outline(space: FreeSpace) -> list[np.ndarray]:
    """Closed lines (n, 2) [m] around the reachable area and around the obstacles in it."""
    contours, _ = cv2.findContours(space.reachable.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return [space.origin + np.vstack([line, line[:1]])[:, 0] * space.cell_m for line in contours]


def make_warp(camera: CameraSettings, rings: int, sectors: int, size: int) -> np.ndarray:
    """Polar image coordinates of each pixel of the round picture: column, row [px] (size, size, 2), NaN outside.

    Columns count from one sector before the first, since ``warp_round`` adds a sector on either side.
    """
    place = project_polar(make_lens(camera), round_rays(make_lens(camera), size), rings, sectors)
    row, column = np.clip(place[..., 0], 0, rings - 1), place[..., 1] + 1
    return np.stack([column, row], axis=-1).astype(np.float32)


def warp_round(polar: np.ndarray, warp: np.ndarray) -> np.ndarray:
    """The round picture (size, size, 3) of a polar image (rings, sectors, 3), black outside the rim."""
    around = np.concatenate([polar[:, -1:], polar, polar[:, :1]], axis=1)
    outside = np.isnan(warp[..., 0])
    column, row = np.moveaxis(np.where(outside[..., None], np.float32(0), warp), -1, 0)
    picture = cv2.remap(around, column, row, cv2.INTER_LINEAR)
    picture[outside] = 0
    return picture


def enlarge(image: np.ndarray, times: int) -> np.ndarray:
    """An image (rows, columns, 3) with each pixel ``times`` as high and wide."""
    return np.repeat(np.repeat(image, times, axis=0), times, axis=1)


def encode_jpeg(image: np.ndarray) -> bytes:
    """An RGB image (rows, columns, 3) uint8 as JPEG."""
    bgr = np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def colours_of_places(place: np.ndarray) -> np.ndarray:
    """Colours (N, 3) uint8 that tell places (N, 2) [m] apart: hue around the middle, paler towards it."""
    middle = (place.min(axis=0) + place.max(axis=0)) / 2
    offset = (place - middle) / np.maximum(np.ptp(place, axis=0) / 2, 1e-9)
    hue = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1
    saturation = np.clip(0.15 + 0.85 * np.linalg.norm(offset, axis=1), 0, 1)
    return (hsv_to_rgb(np.stack([hue, saturation, np.ones(len(place))], axis=1)) * 255).astype(np.uint8)
