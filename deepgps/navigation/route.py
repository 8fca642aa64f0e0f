"""The floor that the robot has driven, in a method's own frame, and routes over it that keep away from its edge."""

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from deepgps.data.segments import travel
from sim.recording.format import Recording

CELL_M = 0.05  # Side of a cell [m]
DRIVEN_M = 0.08  # Floor this near to the line that the robot's middle has driven counts as driven [m]
MAX_DIFFERENCE_M = 0.1  # Of two images' distance by the map and by the wheels, beyond which the map is wrong there [m]
EDGE_M, EDGE_COST = 0.25, 4.0  # Nearer than this to the edge, the way costs up to so many times more [m]
REACH_M = 0.4  # A place this near to driven floor can be left or reached [m]
SMOOTHINGS = 8  # How often each point of a route is moved to the middle of its neighbours
STEPS = [(r, c) for r, c in product(range(-2, 3), repeat=2) if np.gcd(r, c) == 1]  # To a cell's 16 neighbours


@dataclass(frozen=True)
class Floor:
    """Cells of a floor, rows along y and columns along x."""

    corner_m: np.ndarray  # Middle of the first cell (2,) [m]
    cell_m: float  # Side of a cell [m]
    free: np.ndarray  # Where the robot's middle may be (rows, columns) bool

    @property
    def edge_m(self) -> np.ndarray:
        """Distance of each cell from what is not free [m]."""
        padded = np.pad(self.free.astype(np.uint8), 1)
        return cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] * self.cell_m

    def places(self, cells: np.ndarray) -> np.ndarray:
        """Middles (n, 2) [m] of cells (n, 2), each a row and a column."""
        return self.corner_m + cells[:, ::-1] * self.cell_m

    def find(self, place: np.ndarray) -> np.ndarray | None:
        """The free cell (2,) nearest to a place (2,) [m]; None: none is near, or the place is not finite."""
        cells = np.argwhere(self.free)
        if not len(cells) or not np.isfinite(place).all():
            return None
        apart = np.linalg.norm(self.places(cells) - place, axis=1)
        return cells[apart.argmin()] if apart.min() <= REACH_M else None

    def block(self, place: np.ndarray, radius_m: float) -> "Floor":
        """The floor without what is within a radius [m] of a place (2,) [m]."""
        rows, columns = np.indices(self.free.shape)
        away = self.corner_m + np.stack([columns, rows], axis=-1) * self.cell_m - place
        return replace(self, free=self.free & (np.hypot(*np.moveaxis(away, -1, 0)) > radius_m))

    def ways(self, start: np.ndarray, cost: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Ways over the floor from a cell (2,) to each cell [m], infinite where there is none, and the cells before it.

        Each way is that of the least cost, if there is a cost of a metre at each cell; both arrays are (rows, columns).
        """
        shape, number = self.free.shape, np.arange(self.free.size).reshape(self.free.shape)
        edges = [_link(self.free, number, step) for step in STEPS]
        first, second = (np.concatenate(part) for part in zip(*edges, strict=True))
        (r, c), (s, d) = np.unravel_index(first, shape), np.unravel_index(second, shape)
        length = np.hypot(s - r, d - c) * self.cell_m
        if cost is not None:
            length *= (cost.ravel()[first] + cost.ravel()[second]) / 2.0
        graph = csr_matrix((length, (first, second)), (number.size, number.size))
        far, before = dijkstra(graph, indices=number[tuple(start)], return_predecessors=True)
        return far.reshape(shape), before.reshape(shape)

    def plan(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
        """A smooth route (n, 2) [m] between two places (2,) that keeps away from the edge; None: there is none."""
        first, last = self.find(start), self.find(goal)
        if first is None or last is None:
            return None
        cost = 1.0 + EDGE_COST * np.clip(1.0 - self.edge_m / EDGE_M, 0.0, 1.0)
        far, before = self.ways(first, cost)
        if not np.isfinite(far[tuple(last)]):
            return None
        number, cells = int(np.ravel_multi_index(tuple(last), self.free.shape)), []
        while number >= 0:
            cells.append(np.unravel_index(number, self.free.shape))
            number = int(before.ravel()[number])
        route = self.places(np.array(cells[::-1]))
        return self._smooth(np.concatenate([start[None], route[1:-1], goal[None]]))

    def is_free(self, places: np.ndarray) -> np.ndarray:
        """Whether places (n, 2) [m] are on the floor (n,) bool."""
        column, row = np.rint((places - self.corner_m) / self.cell_m).astype(int).T
        inside = (row >= 0) & (row < self.free.shape[0]) & (column >= 0) & (column < self.free.shape[1])
        return inside & self.free[np.where(inside, row, 0), np.where(inside, column, 0)]

    def _smooth(self, route: np.ndarray) -> np.ndarray:
        """The route in steps of a cell, each point between its neighbours where that is on the floor."""
        along = measure_along(route)
        at = np.linspace(0.0, along[-1], max(2, round(along[-1] / self.cell_m) + 1))
        route = np.stack([np.interp(at, along, part) for part in route.T], axis=1)
        for _ in range(SMOOTHINGS):
            middle = (route[:-2] + route[2:]) / 2.0
            route[1:-1] = np.where(self.is_free(middle)[:, None], middle, route[1:-1])
        return route


def measure_along(route: np.ndarray) -> np.ndarray:
    """Distance along a route (n, 2) at each point (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])


def lay_floor(recording: Recording, places: np.ndarray) -> Floor:
    """The floor along the segments of a recording, by its observations' places (N, 2) [m] on a method's map.

    Two images between which map and wheels differ are left out.
    """
    segment, number = recording.reading[:, 0], recording.reading[:, 1]
    wheels_m = np.diff(travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1))
    one, other = places[number[:-1]], places[number[1:]]
    apart_m = np.linalg.norm(other - one, axis=1)
    right = (np.diff(segment) == 0) & (np.abs(apart_m - np.abs(wheels_m)) < MAX_DIFFERENCE_M)  # NaN is not
    parts = [
        start + np.linspace(0.0, 1.0, int(length / CELL_M) + 2)[:, None] * (end - start)
        for start, end, length in zip(one[right], other[right], apart_m[right], strict=True)
    ]
    line = np.concatenate([np.empty((0, 2)), *parts])
    if not len(line):
        return Floor(np.zeros(2), CELL_M, np.zeros((1, 1), bool))
    low, high = line.min(axis=0) - 2 * DRIVEN_M, line.max(axis=0) + 2 * DRIVEN_M
    columns, rows = (np.ceil((high - low) / CELL_M).astype(int) + 1).tolist()
    middles = low + np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * CELL_M
    driven = KDTree(line).query(middles, distance_upper_bound=DRIVEN_M)[0] <= DRIVEN_M
    parts_of_floor = label(driven, np.ones((3, 3)))[0]
    largest = np.bincount(parts_of_floor[driven]).argmax() if driven.any() else 0
    return Floor(low, CELL_M, driven & (parts_of_floor == largest))


def _link(free: np.ndarray, number: np.ndarray, step: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of free cells and of those that a step leads to, if these are free, too, and what is between."""

    def move(array: np.ndarray, rows: int, columns: int) -> np.ndarray:
        """What is so many rows and columns further on, at each cell; False or -1 outside."""
        padded = np.pad(array, 2, constant_values=-1 if array.dtype != bool else 0)
        return padded[2 + rows : 2 + rows + array.shape[0], 2 + columns : 2 + columns + array.shape[1]]

    (r, c), both = step, free & move(free, *step)
    for half in {(int(r / 2), int(c / 2)), (r - int(r / 2), c - int(c / 2))} if max(abs(r), abs(c)) == 2 else set():
        both &= move(free, *half)
    return number[both], move(number, r, c)[both]
