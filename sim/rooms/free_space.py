"""Where the robot fits: a cylinder of its radius and height on the floor, against every geom of a compiled room."""

import mujoco
import numpy as np
from scipy import ndimage

from sim.errors import InputError, shorten
from sim.geometry import FreeSpace
from sim.rooms.spec import DRAWN_GROUPS

CLEARANCE_M = 0.005  # The wheels climb over anything lower than this [m]: the floor itself, rugs, thresholds
MAX_CELLS = 4_000_000
MAX_BLOCK_CELLS = 32
START = "start"
_EPSILON = 1e-6


def find_free_space(model: mujoco.MjModel, radius_m: float, height_m: float, cell_m: float = 0.02) -> FreeSpace:
    """Find the cells in which an upright cylinder of the robot's size [m] touches no colliding geom of its room.

    A block of cells is decided at once if the cylinder in its middle is further from a geom than the block's corners
    are from its middle: the signed distance between two bodies changes by no more than one of them moves. Raises
    InputError if no free space is enclosed by walls, the site ``start`` is not free, or the room is too large.
    """
    probe = _Probe(model, radius_m, height_m)
    origin, shape = _search_area(probe, radius_m, cell_m)
    blocked = np.zeros(shape, bool)
    for geom in probe.obstacles:
        _block(blocked, probe, geom, origin, cell_m)
    for terrain in probe.terrains:
        _block_terrain(blocked, probe, terrain, origin, cell_m)
    free = ~blocked
    label = np.zeros(free.shape, np.int32)
    ndimage.label(free, output=label)
    region, start = _enclosed_region(probe, label, origin, cell_m)
    return FreeSpace(
        origin=origin,
        cell_m=cell_m,
        free=free,
        reachable=region,
        start=start,
        shorter_side_m=_shorter_side(region, cell_m) + 2.0 * radius_m,
    )


def collides(model: mujoco.MjModel) -> np.ndarray:
    """Return a mask (ngeom,) of the geoms that collide with a robot whose geoms have contype = conaffinity = 1."""
    return ((model.geom_contype & 1) | (model.geom_conaffinity & 1)) != 0


class _Probe:
    """A separate model with the probe and a copy of each colliding geom, at its place in the room's rest state."""

    def __init__(self, model: mujoco.MjModel, radius_m: float, height_m: float) -> None:
        rest = mujoco.MjData(model)
        mujoco.mj_kinematics(model, rest)
        self.radius_m = radius_m
        self.room, self.room_data = model, rest
        reach_m = height_m - CLEARANCE_M
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(radius_m, reach_m / 2, 0.0))
        self.terrains: list[int] = []
        copied: set[str] = set()
        for geom in map(int, np.flatnonzero(collides(model))):
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
                self.terrains.append(geom)
            elif not _below(model, rest, geom, CLEARANCE_M):
                _copy_geom(spec, model, rest, geom, copied)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.probe = self.model.geom("probe").id
        self.obstacles = [geom for geom in range(self.model.ngeom) if geom != self.probe]
        self.middle_z_m = CLEARANCE_M + reach_m / 2
        self.top_m = height_m

    def distance(self, geom: int, x: float, y: float, limit_m: float) -> float:
        """Return the signed distance between a geom and the probe at (x, y), at most ``limit_m`` [m]."""
        self.data.geom_xpos[self.probe] = (x, y, self.middle_z_m)
        return mujoco.mj_geomDistance(self.model, self.data, self.probe, geom, limit_m, None)


def _below(model: mujoco.MjModel, data: mujoco.MjData, geom: int, z_m: float) -> bool:
    """Whether a geom has nothing above the height ``z_m``."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        return bool(normal[2] > 1 - _EPSILON and data.geom_xpos[geom, 2] <= z_m)
    return bool(box_of(model, data, geom)[1][2] <= z_m)


def box_of(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner (3,) of the world-aligned box around a geom's own bounding box [m]."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    centre = data.geom_xpos[geom] + rotation @ model.geom_aabb[geom, :3]
    half = np.abs(rotation) @ model.geom_aabb[geom, 3:]
    return centre - half, centre + half


def _copy_geom(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData, geom: int, copied: set[str]) -> None:
    """Copy a geom to the world body of another model, with its mesh unless that is already ``copied``."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, data.geom_xmat[geom])
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    copy = spec.worldbody.add_geom(type=kind, pos=data.geom_xpos[geom], quat=quat)
    if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
        mesh = model.geom_dataid[geom]
        name = f"mesh_{mesh}"
        if name not in copied:
            copied.add(name)
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            # Only the vertices are needed: MuJoCo collides a mesh as their convex hull.
            spec.add_mesh(name=name, uservert=model.mesh_vert[first : first + count].ravel())
        copy.type = mujoco.mjtGeom.mjGEOM_MESH
        copy.meshname = name
    else:
        copy.size = model.geom_size[geom]


def _search_area(probe: _Probe, radius_m: float, cell_m: float) -> tuple[np.ndarray, tuple[int, int]]:
    """Return the middle of the first cell (2,) [m] and the rows and columns that hold all obstacles and a border."""
    corners = []
    for geom in probe.obstacles:
        if probe.model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            corners += box_of(probe.model, probe.data, geom)
            continue
        # A plane blocks everything behind it; only its drawn rectangle bounds the room.
        rotation = probe.data.geom_xmat[geom].reshape(3, 3)
        half = np.abs(rotation[:, :2]) @ probe.model.geom_size[geom, :2]
        corners += [probe.data.geom_xpos[geom] - half, probe.data.geom_xpos[geom] + half]
    for geom in probe.terrains:
        corners += box_of(probe.room, probe.room_data, geom)
    if not corners:
        raise InputError(f"room: nothing stands on the floor, so no free space is enclosed by walls{_explain(probe)}")
    border = radius_m + 3 * cell_m
    # The grid passes through the room's origin, wherever its walls are.
    low = np.floor((np.min(corners, axis=0)[:2] - border) / cell_m)
    high = np.ceil((np.max(corners, axis=0)[:2] + border) / cell_m)
    columns, rows = (high - low + 1).tolist()
    if not rows * columns <= MAX_CELLS:  # NaN is neither larger nor smaller
        raise InputError(
            f"room: {columns * cell_m:.6g} m x {rows * cell_m:.6g} m is too large: at most "
            f"{MAX_CELLS * cell_m**2:.0f} m2 at cells of {cell_m} m"
        )
    return low * cell_m, (int(rows), int(columns))


def _block(blocked: np.ndarray, probe: _Probe, geom: int, origin: np.ndarray, cell_m: float) -> None:
    """Mark the cells in which the probe touches one geom, starting with coarse blocks."""
    rows, columns = blocked.shape
    size = MAX_BLOCK_CELLS
    todo = [(r, c) for r in range(0, rows, size) for c in range(0, columns, size)]
    while todo:
        half_diagonal = (size - 1) / 2 * cell_m * np.sqrt(2.0) + _EPSILON * (size > 1)
        nearer = []
        for row, column in todo:
            if blocked[row : row + size, column : column + size].all():
                continue
            x, y = origin + (np.array((column, row)) + (size - 1) / 2) * cell_m
            distance = probe.distance(geom, x, y, half_diagonal + cell_m)
            if size == 1:
                blocked[row, column] = distance < 0.0
            # A penetration depth is less exact than a distance, so it needs a safety margin.
            elif distance < -1.5 * half_diagonal:
                blocked[row : row + size, column : column + size] = True
            elif distance <= half_diagonal:
                nearer.append((row, column))
        half = size // 2
        todo = [
            (r, c)
            for row, column in nearer
            for r in (row, row + half)
            for c in (column, column + half)
            if r < rows and c < columns
        ]
        size = half
        if size == 0:
            break


def _block_terrain(blocked: np.ndarray, probe: _Probe, geom: int, origin: np.ndarray, cell_m: float) -> None:
    """Mark the cells where a terrain is higher than the clearance anywhere within the probe's radius."""
    model, data = probe.room, probe.room_data
    low, high = box_of(model, data, geom)
    reach = int(np.ceil(probe.radius_m / cell_m))
    above = np.zeros(blocked.shape, bool)
    ray_from = max(high[2], probe.top_m) + 1.0
    rows, columns = blocked.shape
    for row in range(rows):
        for column in range(columns):
            x, y = origin + np.array((column, row)) * cell_m
            if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
                continue
            distance = mujoco.mj_rayHfield(
                model, data, geom, np.array((x, y, ray_from)), np.array((0.0, 0.0, -1.0)), None
            )
            above[row, column] = distance >= 0 and ray_from - distance > CLEARANCE_M
    offset = np.arange(-reach, reach + 1) * cell_m
    disc = offset[:, None] ** 2 + offset[None, :] ** 2 <= probe.radius_m**2
    blocked |= ndimage.binary_dilation(above, disc)


def _enclosed_region(
    probe: _Probe, label: np.ndarray, origin: np.ndarray, cell_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the region of the start site, or else the largest one that is enclosed, and the start (2,) [m]."""
    outside = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    site = mujoco.mj_name2id(probe.room, mujoco.mjtObj.mjOBJ_SITE, START)
    if site >= 0:
        start = probe.room_data.site_xpos[site, :2].copy()
        column, row = np.rint((start - origin) / cell_m).astype(int)
        inside = 0 <= row < label.shape[0] and 0 <= column < label.shape[1]
        if not inside or label[row, column] == 0:
            where = f"({start[0]:g}, {start[1]:g}) m"
            raise InputError(f"room: the site start at {where} is not free for the robot{_explain(probe)}")
        if label[row, column] in outside:
            raise InputError(f"room: the free space about the site start is not enclosed by walls{_explain(probe)}")
        return label == label[row, column], start
    cells = np.bincount(label.ravel())
    cells[0] = 0
    cells[outside] = 0
    if not cells.any():
        raise InputError(f"room: no free space is enclosed by walls{_explain(probe)}")
    region = label == cells.argmax()
    return region, _roomiest(region, origin, cell_m)


def _explain(probe: _Probe) -> str:
    """The end of a message for a room with meshes that collide, of which one for all walls fills the room, or with
    geoms that are only drawn."""
    model, data, why, solid = probe.room, probe.room_data, "", collides(probe.room)
    if (model.geom_type[solid] == mujoco.mjtGeom.mjGEOM_MESH).any():
        why = "; MuJoCo collides a mesh as its convex hull, so split walls that are one mesh into one for each wall"
    drawn = [model.geom(geom).name for geom in np.flatnonzero(~solid & np.isin(model.geom_group, DRAWN_GROUPS))]
    if drawn:
        named = shorten(", ".join(name or "one without a name" for name in drawn), 200)
        why += f"; these of its geoms are only drawn (contype and conaffinity 0): {named}"
    for geom in np.flatnonzero(solid & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)).tolist():
        if data.geom_xmat[geom, 8] > 1 - _EPSILON and (z_m := data.geom_xpos[geom, 2]) > CLEARANCE_M:
            why += f"; it has a floor at z = {z_m:g} m, which must be at 0"
    return why


def _roomiest(region: np.ndarray, origin: np.ndarray, cell_m: float) -> np.ndarray:
    """Return the middle (2,) [m] of the cell that is furthest from everything outside the region."""
    inner = np.asarray(ndimage.distance_transform_edt(region))
    row, column = np.unravel_index(inner.argmax(), region.shape)
    return origin + np.array((column, row)) * cell_m


def _shorter_side(region: np.ndarray, cell_m: float) -> float:
    rows, columns = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    # On average, half a cell is free beyond the outermost cell middles on either side.
    return cell_m * float(min(np.ptp(rows), np.ptp(columns)) + 1)
