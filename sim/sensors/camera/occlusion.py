"""Which geoms walls hide from a camera, seen in plan: what no ray can meet need not be drawn."""

import mujoco
import numpy as np

from sim.geometry import wrap
from sim.rooms.free_space import box_of
from sim.rooms.spec import DRAWN_GROUPS

SHRUNK_M = 0.001  # Walls count as smaller by this on all sides: they hide nothing that a crack between two may show
MIN_DISTANCE_M = 0.05  # Walls nearer than this hide nothing, as the camera's near plane may cut them
MARGIN_RAD = 0.001  # What a wall hides by less than this is drawn: pixels are not exact
FEWEST_WALLS = 5  # Fewer walls are those around one rectangle


class Occlusion:
    """The walls of a room in which nothing moves but the robot: opaque boxes along its axes of the full height.

    They hide geoms that are nowhere lower or higher than they are, from a camera that is not either.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        low, high = (
            np.array([box_of(model, data, geom) for geom in range(model.ngeom)]).reshape(-1, 2, 3).swapaxes(0, 1)
        )
        turn = np.abs(data.geom_xmat.reshape(-1, 3, 3))
        opaque = (model.geom_rgba[:, 3] == 1.0) & (np.append(model.mat_rgba[:, 3], 1.0)[model.geom_matid] == 1.0)
        drawn = np.isin(model.geom_group, DRAWN_GROUPS)
        walls = drawn & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
        walls &= opaque & (turn.max(axis=-1) > 1 - 1e-9).all(axis=-1) & (low[:, 2] <= 1e-6)
        self._top_m = high[walls, 2].max(initial=0.0)
        walls &= high[:, 2] > self._top_m - 1e-6
        others = drawn & ~walls & (low[:, 2] > -1e-6) & (high[:, 2] < self._top_m + 1e-6)
        others &= model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        self._walls, self._others = np.flatnonzero(walls), np.flatnonzero(others)
        self._plan = _outline(low[walls] + SHRUNK_M, high[walls] - SHRUNK_M)
        self._boxes = _outline(low[others], high[others])
        self._nothing = np.zeros(model.ngeom, bool)

    def find_hidden(self, position: np.ndarray) -> np.ndarray:
        """Mask (ngeom,) of the geoms of which a camera at a position (3,) [m] sees nothing."""
        hidden = self._nothing.copy()
        far = _distance(self._plan, position) > MIN_DISTANCE_M
        walls, numbers = self._plan[far], self._walls[far]
        if len(walls) < FEWEST_WALLS or not 0.0 < position[2] < self._top_m:
            return hidden
        first, last = _span(walls, position)
        edges = np.sort(np.concatenate([first, last]))
        begin, end = np.searchsorted(edges, first), np.searchsorted(edges, last)
        # Between two edges, a wall hides all directions or none; it is farthest at one of the edges.
        step = np.arange(len(edges))[:, None]
        behind = np.where(begin <= end, (begin <= step) & (step < end), (begin <= step) | (step < end))
        reach = _meet(walls, position, edges)
        reach = np.where(behind, [reach, np.roll(reach, -1, axis=0)], np.inf)
        hidden[numbers] = True
        hidden[numbers[reach.argmin(axis=2)]] = False
        limit = reach.max(axis=0).min(axis=1)
        first, last = _span(self._boxes, position)
        first, last = first - MARGIN_RAD, last + MARGIN_RAD
        first += 2 * np.pi * (first < edges[0])
        last += 2 * np.pi * (last < first)
        turns = np.concatenate([edges, edges + 2 * np.pi, edges + 4 * np.pi])
        range_of = np.searchsorted(turns, first, "right") - 1, np.searchsorted(turns, last)
        seen_to = np.maximum.reduceat(np.append(np.tile(limit, 3), 0.0), np.stack(range_of, axis=1).ravel())[::2]
        near = _distance(self._boxes, position)
        hidden[self._others] = (seen_to < near) & (near > MIN_DISTANCE_M)
        return hidden


def _outline(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Corners (n, 4, 2) in plan of boxes from lower and upper corners (n, 3) [m]."""
    x, y = np.stack([low, high], axis=-1)[:, :2].swapaxes(0, 1)
    return np.stack([x[:, [0, 1, 1, 0]], y[:, [0, 0, 1, 1]]], axis=-1)


def _span(boxes: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last direction (n,) [rad] in which a camera outside of boxes sees them."""
    x, y = np.moveaxis(boxes - position[:2], -1, 0)
    middle = np.arctan2(y.mean(axis=1), x.mean(axis=1))
    off = wrap(np.arctan2(y, x) - middle[:, None])
    return wrap(middle + off.min(axis=1)), wrap(middle + off.max(axis=1))


def _distance(boxes: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] to the nearest point of boxes."""
    low, high = boxes[:, 0] - position[:2], boxes[:, 2] - position[:2]
    return np.hypot(*np.maximum(np.maximum(low, -high), 0.0).T)


def _meet(boxes: np.ndarray, position: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distance (directions, n) [m] at which rays enter boxes that they meet."""
    rays = np.stack([np.cos(directions), np.sin(directions)])[..., None]
    rays = 1.0 / np.where(rays == 0.0, 1e-12, rays)
    low, high = (boxes[:, corner] - position[:2] for corner in (0, 2))
    x, y = (np.minimum(low[:, axis] * rays[axis], high[:, axis] * rays[axis]) for axis in (0, 1))
    return np.maximum(x, y)
