"""A user's own room: an MJCF file, tried out before it is read here, and made static."""

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
from scipy import ndimage

from sim.errors import InputError, quote, shorten
from sim.rooms.free_space import CLEARANCE_M, box_of, collides
from sim.rooms.mjcf_files import read_model
from sim.rooms.spec import ROBOT_PREFIX

FLOOR, FLOOR_BELOW = "floor", "floor_below"
MAX_WALL_M = 0.5  # Boxes that are the floor may end so far before the outside of the walls [m]
_FLOOR_TOLERANCE_M, _PLANE_DEPTH_M = 0.001, 0.002
"""How far from z = 0 the top of a floor may be, and how far below z = 0 the plane under boxes is [m]."""
HOLE, CELL_M, MAX_SIDE_CELLS = "floor_hole_", 0.02, 1000
"""Prefix of the names of what fills holes, side of the cells in which they are looked for [m], and most cells."""
HOLE_TOP_M, HOLE_DEPTH_M = 0.03, 1.0  # What fills a hole is from this depth to this height [m]: the lowest rays see it
SLOW_TRIANGLES = 100_000  # Number of triangles above which a warning says that the room draws slowly


def load_room(path: Path) -> mujoco.MjSpec:
    """Read an MJCF file as a static room without actuators, keeping its own floor.

    Files that it includes or uses must be in its own folder. A floor is a plane, a horizontal box top or a terrain at z
    = 0. Unless it is a plane or a terrain, an infinite plane ``floor`` is added: at z = 0, or just below boxes, which
    may end before the room does. Holes between boxes are closed by geoms that stop the robot and no camera sees. Raises
    InputError if the file is missing, is not MJCF, refers outside its folder, uses plugins, or takes too long.
    """
    spec, model = read_model(path, "room")
    _refuse_robot_names(spec, path)
    floors, tops = _find_floors(model)
    if floors <= {mujoco.mjtGeom.mjGEOM_BOX}:
        name = FLOOR if spec.geom(FLOOR) is None else FLOOR_BELOW
        z_m = -_PLANE_DEPTH_M if floors else 0.0
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), pos=(0, 0, z_m), group=3)
        for number, (low, high) in enumerate(_find_holes(np.array(tops))):
            corner = np.array([(*low, -HOLE_DEPTH_M), (*high, HOLE_TOP_M)])
            place, half = corner.mean(axis=0), np.ptp(corner, axis=0) / 2
            box = mujoco.mjtGeom.mjGEOM_BOX
            spec.worldbody.add_geom(name=f"{HOLE}{number}", type=box, size=half, pos=place, group=3)
    return spec


def _refuse_robot_names(spec: mujoco.MjSpec, path: Path) -> None:
    """Refuse names that the robot's own parts may have."""
    named = (spec.bodies, spec.geoms, spec.sites, spec.cameras, spec.materials, spec.textures, spec.meshes)
    for element in [element for group in named for element in group]:
        if element.name.startswith(ROBOT_PREFIX):
            name = f"the name {quote(element.name)} begins with {ROBOT_PREFIX}, as the robot's own parts do"
            raise InputError(f"room.mjcf {shorten(str(path), 300)}: {name}")


def list_notes(model: mujoco.MjModel) -> list[str]:
    """What the owner of a room should know of it, in one line each; often nothing."""
    notes = []
    if lamps := int((model.light_type == mujoco.mjtLightType.mjLIGHT_POINT).sum()):
        notes.append(
            f'room: {lamps} of {model.nlight} lamps have type="point", which MuJoCo does not draw: they give no light, '
            'and type="spot" does'
        )
    holes = [geom for geom in map(model.geom, range(model.ngeom)) if geom.name.startswith(HOLE)]
    if area_m2 := sum(4.0 * geom.size[0] * geom.size[1] for geom in holes):
        notes.append(f"room: holes in its floor, of {area_m2:.2g} m2 in all, are no floor: they stop the robot")
    if covered := _find_covered(model):
        notes.append(f"room: a plane at z = 0 is added as its floor, also {covered}")
    if (triangles := _count_triangles(model)) > SLOW_TRIANGLES:
        notes.append(f"room: its meshes draw {triangles:,} triangles, which set the time of each picture")
    return notes


def _find_covered(model: mujoco.MjModel) -> str | None:
    """What a floor that was added covers: what lies below it, or what is beyond boxes that end before the room does."""
    data, floors = mujoco.MjData(model), (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_group == 3)
    mujoco.mj_kinematics(model, data)
    added = [geom for geom in np.flatnonzero(floors).tolist() if model.geom(geom).name in {FLOOR, FLOOR_BELOW}]
    solid = np.flatnonzero(collides(model) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)).tolist()
    if not added or not solid:
        return None
    low, high = np.array([box_of(model, data, geom) for geom in solid]).transpose(1, 0, 2)
    tops = np.array(_find_floors(model)[1])
    if not len(tops):
        return "over what lies below it" if low[:, 2].min() < -CLEARANCE_M else None
    begins, ends = tops[:, 0].min(axis=0) - low[:, :2].min(axis=0), high[:, :2].max(axis=0) - tops[:, 1].max(axis=0)
    return "beyond the ends of its boxes" if max(begins.max(), ends.max()) > MAX_WALL_M else None


def _count_triangles(model: mujoco.MjModel) -> int:
    drawn = model.geom_dataid[model.geom_type == mujoco.mjtGeom.mjGEOM_MESH]
    return int(model.mesh_facenum[drawn[drawn >= 0]].sum())


def _find_floors(model: mujoco.MjModel) -> tuple[set[mujoco.mjtGeom], list[np.ndarray]]:
    """Types of the geoms with something horizontal at z = 0 that collides and could carry the robot, and the lower and
    upper corner (2, 2) of each such box [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found, tops = set(), []
    for geom in np.flatnonzero(collides(model)).tolist():
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        up, top = data.geom_xmat[geom].reshape(3, 3)[2], data.geom_xpos[geom, 2]
        if kind == mujoco.mjtGeom.mjGEOM_BOX and np.abs(up).max() > 0.9999:
            top += np.abs(up) @ model.geom_size[geom]
            if abs(top) < CLEARANCE_M:
                tops.append(np.array(box_of(model, data, geom))[:, :2])
        elif kind != mujoco.mjtGeom.mjGEOM_HFIELD and (kind != mujoco.mjtGeom.mjGEOM_PLANE or up[2] <= 0.9999):
            continue
        if abs(top) < _FLOOR_TOLERANCE_M:
            found.add(kind)
    return found, tops


def _find_holes(tops: np.ndarray) -> list[np.ndarray]:
    """Lower and upper corners (2, 2) of rectangles in the holes of a floor between boxes (n, 2, 2), but for cracks
    [m]."""
    if len(tops) < 2:
        return []
    low, high = tops[:, 0].min(axis=0), tops[:, 1].max(axis=0)
    cell = max(CELL_M, (high - low).max() / MAX_SIDE_CELLS)
    x, y = (np.arange(low[axis] + cell / 2, high[axis], cell) for axis in (0, 1))
    hole = np.ones((len(x), len(y)), bool)
    for one, other in tops:
        hole &= ~np.logical_and.outer((one[0] <= x) & (x <= other[0]), (one[1] <= y) & (y <= other[1]))
    hole = ndimage.binary_opening(hole, np.ones((2, 2)))
    bands = [0, *(np.flatnonzero((hole[1:] != hole[:-1]).any(axis=1)) + 1).tolist(), len(x)]  # of equal rows
    return [
        low + cell * np.array([[first, start], [last, end]])
        for first, last in pairwise(bands)
        for start, end in np.flatnonzero(np.diff(hole[first], prepend=False, append=False)).reshape(-1, 2).tolist()
    ]
