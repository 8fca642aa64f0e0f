"""The robot's own map of the floor: cells that range rays passed or met, and by how many segments each was passed.

Its frame is the robot's at its start: x ahead, y to the left.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from scipy import ndimage

from sim.robot.motion import Robot
from sim.robot.range_finder import REACH_M, lay_fan

CELL_M, CELLS = 0.025, 2560  # Side of a cell [m], and cells along each side of the grid, which ends 32 m from the start
LOOKS = 9  # Headings at which the fans look along for a scan all around
MARGIN_M = 0.04  # Floor this near to what a ray met is not marked as free [m]
ERASING_RADIUS_M = 1.0  # Nearer than this, hardly an obstacle fits between two rays of a scan [m]
MEETING, MOST_MEETINGS, CONTACT = 3, 9, 30
"""What was met once, often, or touched is forgotten after so many scans from nearby that do not meet it."""
FRONT_M = 0.6  # Touches along more than the way through a door are of things that no ray meets [m]
BODY_CELLS = 7  # Width of what a robot's body surely passes
CONTACT_RAD = 0.6  # What was touched is within this angle of straight ahead [rad]
SWATH_M = 0.225  # Floor this near to a segment is within 0.25 m of an image [m]
DRAWN_BITS = 6  # OpenCV draws to this fraction of a cell
FLOOR_CELL_M = 2 * CELL_M
TOLERANCE_M = 0.01  # A map of cells may be wrong by this on how wide an opening is: the rays decide [m]
SQUARE, CROSS = (cv2.getStructuringElement(shape, (3, 3)) for shape in (cv2.MORPH_RECT, cv2.MORPH_CROSS))


class Scan(NamedTuple):
    """Rays all around: angles (n,), ascending to the left from straight ahead [rad], and lengths (n,) [m]."""

    angle: np.ndarray
    length: np.ndarray

    def points(self, pose: np.ndarray) -> np.ndarray:
        """Places (m, 2) [m] of what the rays met, from a pose (3,)."""
        met = self.length < REACH_M
        return go(pose, self.angle[met], self.length[met])


def scan(robot: Robot) -> Scan:
    """Look all around."""
    fan, turned = lay_fan(robot.body.radius_m).angle, 2 * np.pi * np.arange(LOOKS) / LOOKS
    length = np.stack([robot.ranges(REACH_M, one).reshape(-1, len(fan)).min(axis=0) for one in turned])
    angle = (turned[:, None] + fan).ravel() % (2 * np.pi)
    order = np.argsort(angle, kind="stable")
    return Scan(angle[order], length.ravel()[order])


def go(pose: np.ndarray, angle: np.ndarray | float, length_m: np.ndarray | float) -> np.ndarray:
    """Places (..., 2) [m] at angles to the left of a pose's heading [rad] and distances [m]."""
    heading = pose[2] + angle
    return pose[:2] + np.asarray(length_m)[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)


class Floor(NamedTuple):
    """The floor by a map, in cells of FLOOR_CELL_M, rows along y and columns along x."""

    corner_m: np.ndarray  # Where the first cell begins (2,) [m]
    fits: np.ndarray  # Whether the robot's middle fits there
    open: np.ndarray  # The same by rays alone, whatever was touched
    shut: np.ndarray  # Whether it does not fit by what was touched along a front
    been: np.ndarray  # Whether its body was there
    edge: np.ndarray  # Whether the cell or one beside it is not known
    passes: np.ndarray  # By how many segments it was passed

    def find(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows and columns of places (..., 2) [m], and whether they are on the map; others get the first cell's."""
        column, row = np.moveaxis(np.floor((place - self.corner_m) / FLOOR_CELL_M).astype(int), -1, 0)
        inside = (row >= 0) & (row < self.fits.shape[0]) & (column >= 0) & (column < self.fits.shape[1])
        return np.where(inside, row, 0), np.where(inside, column, 0), inside

    def places(self, cells: np.ndarray) -> np.ndarray:
        """Middles (n, 2) [m] of the marked cells."""
        return self.corner_m + (np.argwhere(cells)[:, ::-1] + 0.5) * FLOOR_CELL_M

    def way(self, goals: np.ndarray) -> np.ndarray:
        """Way over the floor from each cell to the nearest goal [m], a mask of cells; infinite where there is none."""
        inside, reached = self.fits.astype(np.uint8), (goals & self.fits).astype(np.uint8)
        way = np.where(reached, 0.0, np.inf)
        for step in range(1, self.fits.size):
            wider = np.bitwise_and(cv2.dilate(reached, SQUARE if step % 2 else CROSS), inside)
            new = wider != reached
            if not new.any():
                break
            way[new], reached = step * FLOOR_CELL_M, wider
        return way


class GridMap:
    """The cells of the floor, rows along y and columns along x."""

    def __init__(self) -> None:
        # Positive where something stands, -1 where nothing does, 0 where no ray was; how many segments passed
        self.seen, self.passes = np.zeros((CELLS, CELLS), np.int8), np.zeros((CELLS, CELLS), np.uint16)
        self.felt = np.zeros((CELLS, CELLS), np.int8)  # 1 where something was touched last, -1 where the body was
        # What is in use, from one column and row to before another, in even numbers
        self.low, self.high = np.full(2, CELLS // 2), np.full(2, CELLS // 2 + 2)

    @property
    def box(self) -> tuple[slice, slice]:
        """Rows and columns in use."""
        return slice(self.low[1], self.high[1]), slice(self.low[0], self.high[0])

    @property
    def corner_m(self) -> np.ndarray:
        """Where the first cell in use begins (2,) [m]."""
        return (self.low - CELLS // 2) * CELL_M

    def add(self, pose: np.ndarray, seen: Scan) -> None:
        """Mark what a scan from a pose (3,) x, y [m], heading [rad] met, and the floor up to there."""
        box = self._use(pose[:2] - REACH_M, pose[:2] + REACH_M)
        cells, both = self.seen[box], np.stack([seen.angle, np.roll(seen.angle, -1)], axis=-1).ravel()
        free_m = np.maximum(np.minimum(seen.length, np.roll(seen.length, -1)) - MARGIN_M, 0.0).repeat(2)
        far, near = np.zeros(cells.shape, np.uint8), np.zeros(cells.shape, np.uint8)
        for mask, most_m in ((far, REACH_M), (near, ERASING_RADIUS_M)):
            cv2.fillPoly(mask, [_draw(go(pose, both, np.minimum(free_m, most_m)), box)], 1, shift=DRAWN_BITS)
        cells[(far > 0) & (cells == 0)] = -1
        cells[(near > 0) & (cells > 0)] -= 1
        met = find(seen.points(pose))
        self.seen[met] = np.minimum(np.maximum(self.seen[met], 0) + MEETING, MOST_MEETINGS)

    def touch(self, pose: np.ndarray, radius_m: float) -> None:
        """Mark what a robot of a radius [m] touched at a pose (3,): something before it that its rays do not see."""
        met = find(go(pose, np.linspace(-CONTACT_RAD, CONTACT_RAD, 9), radius_m + CELL_M))
        self.seen[met], self.felt[met] = CONTACT, 1

    def pass_over(self, start: np.ndarray, end: np.ndarray) -> None:
        """Note a segment from one place to another (2,) [m]."""
        box = self._use(np.minimum(start, end) - SWATH_M, np.maximum(start, end) + SWATH_M)
        mask = np.zeros(self.passes[box].shape, np.uint8)
        first, last = _draw(np.stack([start, end]), box).tolist()
        self.passes[box] += cv2.line(mask, first, last, 1, round(2 * SWATH_M / CELL_M), shift=DRAWN_BITS)
        self.felt[box][cv2.line(mask * 0, first, last, 1, BODY_CELLS, shift=DRAWN_BITS) > 0] = -1

    def read_floor(self, radius_m: float) -> Floor:
        """The floor for a robot of a radius [m]."""
        seen, felt, disc = self.seen[self.box], self.felt[self.box], _lay_disc(radius_m - TOLERANCE_M)

        def fit(obstacle: np.ndarray) -> np.ndarray:
            return _halve((seen != 0) & (cv2.dilate(obstacle.astype(np.uint8), disc) == 0))

        touched, met = felt > 0, (seen > 0) & (seen <= MOST_MEETINGS)
        by_rays, been = fit(met), _halve(felt < 0)
        shut = by_rays & ~_open_doors(by_rays, fit(met | touched), been) if touched.any() else by_rays & False
        fits = fit(seen > 0) & ~shut if (seen > MOST_MEETINGS).any() else by_rays & ~shut
        edge = cv2.dilate(_halve(seen == 0).astype(np.uint8), SQUARE) > 0
        passes = self.passes[self.box][::2, ::2]
        return Floor(self.corner_m, fits, by_rays, shut, been, edge, passes)

    def _use(self, low_m: np.ndarray, high_m: np.ndarray) -> tuple[slice, slice]:
        """Rows and columns between two corners (2,) [m], and a few more, which are in use from now on."""
        low = np.clip(np.floor(low_m / CELL_M).astype(int) + CELLS // 2 - 2, 0, CELLS - 2) // 2 * 2
        high = np.clip(np.ceil(high_m / CELL_M).astype(int) + CELLS // 2 + 3, 2, CELLS) // 2 * 2
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
        return slice(low[1], high[1]), slice(low[0], high[0])


@lru_cache
def _lay_disc(radius_m: float) -> np.ndarray:
    """Cells (n, n) that are at most so far from the middle one [m], as OpenCV measures."""
    reach = math.ceil(radius_m / CELL_M)
    others = np.pad(np.zeros((1, 1), np.uint8), reach, constant_values=1)
    away = cv2.distanceTransform(others, cv2.DIST_L2, cv2.DIST_MASK_5)
    return (away * CELL_M <= radius_m).astype(np.uint8)


def _halve(cells: np.ndarray) -> np.ndarray:
    """Cells twice as large, of which one of four is marked."""
    return cells[::2, ::2] | cells[1::2, ::2] | cells[::2, 1::2] | cells[1::2, 1::2]


def _open_doors(by_rays: np.ndarray, fits: np.ndarray, been: np.ndarray) -> np.ndarray:
    """Where a robot fits by its rays and, less, by all that it touched, with what only touches shorter than a front cut
    off from where it was: these may be beside a door."""
    own = find_reached(fits, been)
    cut = by_rays & ~own
    parts = cv2.connectedComponents(cut.astype(np.uint8), connectivity=4)[1]
    border = np.where(cv2.dilate(own.astype(np.uint8), SQUARE) > 0, parts, 0)
    fronts = [max(side.stop - side.start for side in one) if one else CELLS for one in ndimage.find_objects(border)]
    short = 1 + np.flatnonzero(np.array(fronts) * FLOOR_CELL_M < FRONT_M)
    return fits | np.isin(parts, np.intersect1d(parts[cut & fits], short))


def find_reached(floor: np.ndarray, been: np.ndarray) -> np.ndarray:
    """The parts of the floor, a mask of cells, in which the robot was, a mask, too; all before it was anywhere."""
    count, marked = cv2.connectedComponents(floor.astype(np.uint8), connectivity=4)
    parts, reached = np.asarray(marked, np.int32), np.zeros(count, bool)
    reached[parts[floor & been]] = True
    return floor & reached[parts] if been.any() else floor


def find(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (n,) on a map of places (n, 2) [m]."""
    column, row = np.clip(np.floor(place / CELL_M).astype(int) + CELLS // 2, 0, CELLS - 1).T
    return row, column


def _draw(place: np.ndarray, box: tuple[slice, slice]) -> np.ndarray:
    """Places (n, 2) [m] in a box, as OpenCV takes them: whole numbers are at the middles of cells."""
    pixel = place / CELL_M + (CELLS // 2 - box[1].start - 0.5, CELLS // 2 - box[0].start - 0.5)
    return np.rint(pixel * 2**DRAWN_BITS).astype(np.int32)
