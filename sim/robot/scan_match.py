"""Where the robot is, by its rays: the pose near a guess from which a scan meets what stands on its map.

Wheel angles tell the pose to a millimetre until wheels slip, as when the robot frees itself from between two legs.
"""

import cv2
import numpy as np

from sim.robot.grid_map import CELL_M, GridMap, Scan
from sim.robot.range_finder import REACH_M

BLUR_M = 0.15  # A point farther than this from all that stands on the map agrees with nothing [m]
UNKNOWN_AGREEMENT = 0.5  # A point where nothing is known yet agrees by this
RIGHT_AGREEMENT, ENOUGH_AGREEMENT = 0.95, 0.85
"""With the first the pose by the wheels is right, with the second no pose is looked for farther away."""
BETTER_BY, BETTER_IN_DOUBT_BY = 0.1, 0.02  # A pose that agrees better by this replaces that by the wheels
SEARCHES = ((2.0, 3, 0.05, 3), (3.0, 60, 0.1, 6))
"""Steps of a search [deg], how many to either side, steps along x and y [m], how many."""
FINE_SEARCH = (0.5, 4, 0.02, 3)
FARTHEST_CELLS = round((REACH_M + 1.0) / CELL_M)  # Farther than a search and its points' surroundings reach
FEWEST_POINTS, MOST_POINTS = 20, 90  # Points of a scan that are compared


def match(grid: GridMap, pose: np.ndarray, seen: Scan, doubtful: bool) -> np.ndarray:
    """The pose (3,) x, y [m], heading [rad] of a scan: that by the wheels, unless another agrees better."""
    point = seen.points(np.zeros(3))
    point, field, best = point[:: 1 + len(point) // MOST_POINTS], _find_agreement(grid, pose), pose
    by_wheels = found = _agree(field, grid, pose[None], point)[0] if len(point) >= FEWEST_POINTS else np.inf
    for coarse in SEARCHES if by_wheels < RIGHT_AGREEMENT else ():
        for search in (coarse, FINE_SEARCH):
            turn_deg, turns, step_m, steps = search
            aside, turned = np.arange(-steps, steps + 1) * step_m, np.arange(-turns, turns + 1) * np.radians(turn_deg)
            around = np.stack(np.meshgrid(aside, aside, turned, indexing="ij"), axis=-1).reshape(-1, 3)
            tried = (pose if search is coarse else best) + around
            agreement = _agree(field, grid, tried, point)
            if agreement.max() > found:
                best, found = tried[agreement.argmax()], agreement.max()
        if found >= ENOUGH_AGREEMENT:
            break
    return best if found > by_wheels + (BETTER_IN_DOUBT_BY if doubtful else BETTER_BY) else pose


def _find_agreement(grid: GridMap, pose: np.ndarray) -> np.ndarray:
    """How well a point agrees with the map in each cell of its box: from 1 where something stands to 0.

    Cells that no point of a scan from about the pose (3,) can be in stay at 0.
    """
    seen = grid.seen[grid.box]
    field, middle = np.zeros(seen.shape, np.float32), ((pose[1::-1] - grid.corner_m[::-1]) / CELL_M).astype(int)
    low = np.clip(middle - FARTHEST_CELLS, 0, np.array(seen.shape) - 1)
    near = tuple(map(slice, low, np.maximum(middle + FARTHEST_CELLS, low + 1)))
    seen = seen[near]
    away = cv2.distanceTransform((seen <= 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    field[near] = np.maximum(1.0 - away * (CELL_M / BLUR_M), np.where(seen == 0, UNKNOWN_AGREEMENT, 0.0))
    return field


def _agree(field: np.ndarray, grid: GridMap, poses: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Mean agreement (n,) with the map of points (m, 2) [m] in the frame of a robot at poses (n, 3)."""
    cos, sin = (part(poses[:, 2:]).astype(np.float32) for part in (np.cos, np.sin))
    x, y = point.T.astype(np.float32)
    at_x, at_y = (poses[:, :2] - grid.corner_m).astype(np.float32).T[..., None]
    column = ((at_x + cos * x - sin * y) / CELL_M).astype(np.int32)
    row = ((at_y + sin * x + cos * y) / CELL_M).astype(np.int32)
    return field[row.clip(0, len(field) - 1), column.clip(0, field.shape[1] - 1)].mean(axis=1)
