"""Pictures of rooms for people: a contact sheet, which has for each room a corner view, a top view with the reachable
floor tinted, the fisheye and the polar image."""

from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import get_args

import cv2
import mujoco
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from sim.files.atomic import write_bytes
from sim.geometry import FreeSpace
from sim.robot.world import RoomWorld
from sim.rooms.build import build_room
from sim.rooms.flat import MARK as ROOM_MARK
from sim.rooms.free_space import box_of
from sim.sensors.camera import gl
from sim.sensors.camera.fisheye import Fisheye
from sim.settings import CameraSettings, RoomKind, RoomSettings, RoomShape, SimSettings
from sim.settings.world import MIN_ROOM_SIDE_M

MARK = ("Software", "deepgps")  # Mark of origin in the picture's metadata, so that no other picture is overwritten
ROW_PX = 330
PERSPECTIVE_PX = 560
TOP_VIEW_PX = 430
POLAR_PX = 520
LABEL_PX = 26
MARGIN_PX = 6
MIN_CEILING_M = 1.8
"""Bodies whose origin is higher than this belong to the ceiling and are hidden in the views from above [m]."""
HIDDEN_GROUP = 5
_REACHABLE_COLOUR = np.array((70, 200, 120))
_VIEW = {"azimuth": 58.0, "elevation": -40.0}


def draw_gallery(
    kinds: Sequence[RoomKind],
    seeds: Sequence[int],
    path: Path,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> None:
    """Draw every kind with every seed and write one PNG; a seed's shape is the seed modulo the number of shapes.

    Progress is a stage (``rooms``), the rooms drawn and their number. Raises InputError if a room cannot be built,
    WorkError if nothing can be drawn on this machine.
    """
    gl.choose_backend()
    shapes = get_args(RoomShape)
    rooms = [
        RoomSettings(kind=kind, shape="rectangle" if kind in MIN_ROOM_SIDE_M else shapes[seed % len(shapes)], seed=seed)
        for kind in kinds
        for seed in seeds
    ]
    rows = []
    for room in rooms:
        rows.append(draw_room(room))
        progress("rooms", len(rows), len(rooms))
    buffer, mark = BytesIO(), PngInfo()
    mark.add_text(*MARK)
    Image.fromarray(lay_out(rows)).save(buffer, "png", pnginfo=mark)
    write_bytes(path, buffer.getvalue())


def lay_out(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of one size below one another, in as many columns as make the sheet about square; white where none is."""
    height, width, _ = rows[0].shape
    columns = max(1, round((len(rows) * height / width) ** 0.5))
    deep = -(-len(rows) // columns)
    blank = [np.full_like(rows[0], 255)] * (columns * deep - len(rows))
    sheet = [*rows, *blank]
    return np.hstack([np.vstack(sheet[column * deep : (column + 1) * deep]) for column in range(columns)])


def is_gallery(data: bytes) -> bool:
    """Whether these are the contents of a picture that ``draw_gallery`` wrote."""
    return data.startswith(b"\x89PNG") and "\0".join(MARK).encode() in data[:500]


def draw_room(settings: RoomSettings) -> np.ndarray:
    """Draw one row of the sheet, (rows, columns, 3) uint8 RGB."""
    spec = build_room(settings)
    world = RoomWorld(SimSettings(room=settings), spec)
    world.place(np.array((*world.free_space.start, 0.0)))
    spec.visual.quality.shadowsize = 2048
    spec.visual.quality.offsamples = 4
    spec.visual.headlight.ambient = [0.42] * 3
    spec.visual.headlight.diffuse = spec.visual.headlight.specular = [0.0] * 3
    spec.visual.global_.offwidth, spec.visual.global_.offheight = PERSPECTIVE_PX, ROW_PX
    spec.visual.rgba.haze = [1.0] * 4
    model = spec.compile()
    if model.nlight:
        model.light_castshadow[0] = True
    pictures = _draw_perspective(model), _draw_top(model, world.free_space), _draw_fisheye(world), _draw_polar(world)
    title = settings.mjcf or f"{settings.kind}, {settings.shape}, seed {settings.seed}"
    area = world.free_space.reachable.sum() * world.free_space.cell_m**2
    drawn = int((model.geom_group <= 2).sum())
    return _label(_beside(pictures), f"{title}: {area:.1f} m2 reachable, {drawn} shapes drawn")


def _draw_perspective(model: mujoco.MjModel) -> np.ndarray:
    """Draw the room from above a corner, without the ceiling and the walls seen from behind."""
    low, high = _extent(model)
    view = mujoco.MjvCamera()
    view.azimuth, view.elevation = _VIEW["azimuth"], _VIEW["elevation"]
    view.lookat[:] = (*(low + high)[:2] / 2, 0.6)
    view.distance = 1.02 * float(np.hypot(*(high - low)[:2])) + 0.7
    azimuth, elevation = np.radians((view.azimuth, view.elevation))
    ahead = np.array((np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)))
    eye, data, hidden = view.lookat - view.distance * ahead, mujoco.MjData(model), _ceiling(model)
    mujoco.mj_kinematics(model, data)
    for body in (number for number in range(model.nbody) if model.body(number).name.startswith("wall_")):
        if (eye - data.xpos[body]) @ data.xmat[body].reshape(3, 3)[:, 1] > 0:
            hidden |= (model.geom_bodyid == body) | (model.body_parentid[model.geom_bodyid] == body)
    return _render(model, view, hidden, (ROW_PX, PERSPECTIVE_PX))


def _draw_top(model: mujoco.MjModel, space: FreeSpace) -> np.ndarray:
    """Draw the room straight from above without the ceiling, with reachable floor tinted and the start as a dot."""
    low, high = _extent(model)
    middle, size = (low + high)[:2] / 2, (high - low)[:2] + 0.2
    metres = max(size[1], size[0] * ROW_PX / TOP_VIEW_PX)
    view = mujoco.MjvCamera()
    view.azimuth, view.elevation, view.distance = 90.0, -90.0, 8.0
    view.lookat[:] = (*middle, 0.0)
    # An orthographic camera's field of view is a length.
    fovy = model.vis.global_.fovy
    model.vis.global_.orthographic, model.vis.global_.fovy = 1, metres
    image = _render(model, view, _ceiling(model), (ROW_PX, TOP_VIEW_PX))
    model.vis.global_.orthographic, model.vis.global_.fovy = 0, fovy
    row, column = np.mgrid[0:ROW_PX, 0:TOP_VIEW_PX] + 0.5
    points = np.stack((column - TOP_VIEW_PX / 2, ROW_PX / 2 - row), axis=-1) * metres / ROW_PX + middle
    tint = space.is_reachable(points)[..., None]
    image = np.where(tint, 0.75 * image + 0.25 * _REACHABLE_COLOUR, image)
    start = np.hypot(*(points - space.start).transpose(2, 0, 1)) < 0.105
    return np.where(start[..., None], (230, 40, 40), image).astype(np.uint8)


def _draw_fisheye(world: RoomWorld) -> np.ndarray:
    with Fisheye(world.model, CameraSettings(face_px=256)) as camera:
        return camera.round(world.data, ROW_PX)


def _draw_polar(world: RoomWorld) -> np.ndarray:
    """Draw the polar image that a network gets, enlarged."""
    with Fisheye(world.model, world.settings.camera) as camera:
        polar = camera.polar(world.data)
    tall = POLAR_PX * polar.shape[0] // polar.shape[1] * 2
    large = cv2.resize(polar, (POLAR_PX, tall), interpolation=cv2.INTER_NEAREST)
    above = (ROW_PX - tall) // 2
    return cv2.copyMakeBorder(large, above, ROW_PX - tall - above, 0, 0, cv2.BORDER_CONSTANT, value=(255, 255, 255))


def _render(model: mujoco.MjModel, view: mujoco.MjvCamera, hidden: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    group = model.geom_group.copy()
    model.geom_group[hidden] = HIDDEN_GROUP
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, *size) as renderer:
        renderer.update_scene(data, view)
        image = renderer.render()
    model.geom_group[:] = group
    # The empty space around a room is black; on the sheet it is white.
    return np.where((image == 0).all(axis=-1, keepdims=True), 255, image).astype(np.uint8)


def _ceiling(model: mujoco.MjModel) -> np.ndarray:
    return model.body_pos[model.geom_bodyid, 2] > MIN_CEILING_M


def _extent(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner (3,) of all that is drawn except planes [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    finite = np.flatnonzero((model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_group <= 2))
    low, high = zip(*(box_of(model, data, geom) for geom in finite.tolist()), strict=True)
    return np.min(low, axis=0), np.max(high, axis=0)


def _beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    edged = [
        cv2.copyMakeBorder(p, MARGIN_PX, 0, MARGIN_PX, 0, cv2.BORDER_CONSTANT, value=(255, 255, 255)) for p in pictures
    ]
    return np.hstack(edged)


def _label(row: np.ndarray, text: str) -> np.ndarray:
    strip = np.full((LABEL_PX, row.shape[1], 3), 255, np.uint8)
    cv2.putText(strip, text, (MARGIN_PX, LABEL_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (20, 20, 20), 1, cv2.LINE_AA)
    return np.vstack([strip, row])


def find_parts(settings: RoomSettings) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 2) and (m, 2) [m] of the free floor of the rooms of a flat, and of its doorways."""
    spec = build_room(settings)
    rooms = [site.pos[:2] for site in spec.sites if site.name.startswith(ROOM_MARK)]
    return np.array(rooms), np.array([body.pos[:2] for body in spec.bodies if body.name.startswith("doorway")])
