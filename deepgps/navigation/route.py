"""The floor that the robot has driven, in a method's own frame: goals, and routes that keep away from its edge."""

from dataclasses import dataclass, replace
from itertools import product
from math import gcd

import cv2
import numpy as np
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from deepgps.data.segments import travel
from sim.errors import InputError
from sim.recording.format import Recording
from sim.rng import stream

CELL_M = 0.05  # Side of a cell [m]
DRIVEN_M = 0.06  # Floor this near to the line that the robot's middle has driven counts as driven [m]
MAX_DIFFERENCE_M = 0.1  # Of two images' distance by the map and by the wheels, beyond which the map is wrong there [m]
EDGE_M, EDGE_COST = 0.25, 4.0  # Nearer than this to the edge, a metre costs up to so many more [m]
MIN_WAY_M = 2.0  # Least way from one goal to the next [m]
MIN_EDGE_M = 0.12  # Least distance of a goal from the edge of the driven floor, where there is such a place [m]
DOOR_GOALS, DOOR_M = 3, 0.5  # Every such goal is through a door; floor this near to a door's middle is its own [m]
REACH_M = 0.4  # A place this near to driven floor can be left or reached [m]
SMOOTHINGS = 8  # How often each point of a route is moved to the middle of its neighbours
BORDER = 2  # Cells at each side of a floor that are never free
STEPS = [step for step in product(range(-BORDER, BORDER + 1), repeat=2) if gcd(*step) == 1]  # To 16 neighbours


@dataclass(frozen=True)
class Floor:
    """Cells of a floor, rows along y and columns along x; none of the first and last ``BORDER`` is free."""

    corner_m: np.ndarray  # Middle of the first cell (2,) [m]
    cell_m: float  # Side of a cell [m]
    free: np.ndarray  # Where the robot's middle may be (rows, columns) bool

    @property
    def edge_m(self) -> np.ndarray:
        """Distance of each cell from what is not free [m]."""
        return cv2.distanceTransform(self.free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * self.cell_m

    def places(self, cells: np.ndarray) -> np.ndarray:
        """Middles (..., 2) [m] of cells (..., 2), each a row and a column."""
        return self.corner_m + cells[..., ::-1] * self.cell_m

    def find(self, place: np.ndarray) -> np.ndarray | None:
        """The free cell (2,) nearest to a place (2,) [m]; None: none is near, or the place is not finite."""
        cells = np.argwhere(self.free)
        if not len(cells) or not np.isfinite(place).all():
            return None
        apart_m = np.linalg.norm(self.places(cells) - place, axis=1)
        return cells[apart_m.argmin()] if apart_m.min() <= REACH_M else None

    def cells(self, places: np.ndarray) -> np.ndarray:
        """Cells (n, 2) of places (n, 2) [m]; where there is none, one of the border, which is not free."""
        cells = np.rint((places - self.corner_m) / self.cell_m).astype(int)[:, ::-1]
        return np.clip(cells, 0, np.array(self.free.shape) - 1)

    def is_free(self, places: np.ndarray) -> np.ndarray:
        """Whether places (n, 2) [m] are on the floor (n,) bool."""
        return self.free[tuple(self.cells(places).T)]

    def measure_edge(self, places: np.ndarray) -> np.ndarray:
        """Distance of places (n, 2) [m] on or beside the floor from where it ends (n,) [m]."""
        return self.edge_m[tuple(self.cells(places).T)]

    def block(self, place: np.ndarray, radius_m: float) -> "Floor":
        """The floor without what is within a radius [m] of a place (2,) [m]."""
        away = self.places(np.moveaxis(np.indices(self.free.shape), 0, -1)) - place
        return replace(self, free=self.free & (np.linalg.norm(away, axis=-1) > radius_m))

    def ways(self, start: np.ndarray, cost: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Ways over the floor from a cell (2,) to each cell [m], infinite where there is none, and the cells before it.

        Each is the way of the least cost, if there is a cost of a metre at each cell; cells are counted row by row.
        """
        number, width = np.arange(self.free.size).reshape(self.free.shape), self.free.shape[1]
        first, second, length = [], [], []
        for row, column in STEPS:
            half = (int(row / 2), int(column / 2))  # a long step passes two cells
            passed = [(row, column), half, (row - half[0], column - half[1])]
            both = self.free & np.all([np.roll(self.free, (-r, -c), (0, 1)) for r, c in passed], axis=0)
            first.append(number[both])
            second.append(number[both] + row * width + column)
            length.append(np.full(both.sum(), np.hypot(row, column) * self.cell_m))
        rows, columns, weight = (np.concatenate(part) for part in (first, second, length))
        if cost is not None:
            weight *= (cost.ravel()[rows] + cost.ravel()[columns]) / 2.0
        graph = csr_matrix((weight, (rows, columns)), (number.size, number.size))
        far, before = dijkstra(graph, indices=number[tuple(start)], return_predecessors=True)
        return far.reshape(self.free.shape), before

    def measure_ways(self, cell: np.ndarray) -> np.ndarray:
        """Way over the floor from a cell (2,) to each cell [m]; 0 where there is none."""
        return np.nan_to_num(self.ways(cell)[0], posinf=0.0)

    def plan(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
        """A smooth route (n, 2) [m] between two places (2,) that keeps away from the edge; None: there is none."""
        first, last = self.find(start), self.find(goal)
        if first is None or last is None:
            return None
        far, before = self.ways(first, 1.0 + EDGE_COST * np.clip(1.0 - self.edge_m / EDGE_M, 0.0, 1.0))
        if not np.isfinite(far[tuple(last)]):
            return None
        number, numbers = int(last[0] * self.free.shape[1] + last[1]), []
        while number >= 0:
            numbers.append(number)
            number = int(before[number])
        route = self.places(np.stack(np.unravel_index(numbers[::-1], self.free.shape), axis=1))
        return self._smooth(np.concatenate([start[None], route[1:-1], goal[None]]))

    def _smooth(self, route: np.ndarray) -> np.ndarray:
        """The route in steps of a cell, each point between its neighbours where that is no nearer to the edge."""
        along = measure_along(route)
        at = np.linspace(0.0, along[-1], max(2, round(along[-1] / self.cell_m) + 1))
        route = np.stack([np.interp(at, along, part) for part in route.T], axis=1)
        for _ in range(SMOOTHINGS):
            middle = (route[:-2] + route[2:]) / 2.0
            free = self.measure_edge(middle) >= np.minimum(self.measure_edge(route[1:-1]), EDGE_M)
            route[1:-1] = np.where(free[:, None], middle, route[1:-1])
        return route


def measure_along(route: np.ndarray) -> np.ndarray:
    """Distance along a route (n, 2) at each point (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])


def lay_floor(recording: Recording, places: np.ndarray) -> Floor:
    """The floor along the segments of a recording, by its observations' places (N, 2) [m] on a method's map.

    Two images whose distance by the map is not that by the wheels are left out.
    """
    segment, number = recording.reading[:, 0], recording.reading[:, 1]
    wheels_m = np.abs(np.diff(travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)))
    one, other = places[number[:-1]], places[number[1:]]
    apart_m = np.linalg.norm(other - one, axis=1)
    right = (np.diff(segment) == 0) & (np.abs(apart_m - wheels_m) < MAX_DIFFERENCE_M)  # NaN is not
    lines = [
        np.linspace(start, end, int(length / CELL_M) + 2)
        for start, end, length in zip(one[right], other[right], apart_m[right], strict=True)
    ]
    line = np.concatenate([np.zeros((1, 2)) if not lines else lines[0], *lines[1:]])
    low, high = (
        limit + sign * (DRIVEN_M + (BORDER + 1) * CELL_M) for limit, sign in ((line.min(0), -1), (line.max(0), 1))
    )
    columns, rows = (np.ceil((high - low) / CELL_M).astype(int) + 1).tolist()
    middles = low + CELL_M * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    driven = (KDTree(line).query(middles)[0] <= DRIVEN_M) & bool(lines)
    parts, _ = label(driven, np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    return Floor(low, CELL_M, driven & (parts == np.bincount(parts[driven], minlength=1).argmax()))


def draw_goals(floor: Floor, seed: int, count: int, doors: np.ndarray | None = None) -> np.ndarray:
    """Goals (count, 2) [m], each at least ``MIN_WAY_M`` over the floor from the one before, or else the farthest.

    A third of them are through one of the doors (n, 2) [m], where the robot has driven. The first of more goals are
    those of fewer. Raises InputError if the floor has no place for a goal.
    """
    rng, open_floor = stream(seed, "goals"), floor
    cells = np.argwhere(floor.free & (floor.edge_m >= min(MIN_EDGE_M, floor.edge_m.max())))
    if not len(cells):
        raise InputError("the method's map has no floor that the robot has driven: it has no place for a goal")
    for door in () if doors is None else doors:
        open_floor = open_floor.block(door, DOOR_M)
    rooms, _ = label(open_floor.free, np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    room = rooms[tuple(cells.T)]
    goals = [int(rng.integers(len(cells)))]
    for number in range(count):
        far = floor.measure_ways(cells[goals[-1]])[tuple(cells.T)]
        apart = far >= min(MIN_WAY_M, far.max())
        through = apart & (room != room[goals[-1]]) & (room > 0)
        if number % DOOR_GOALS == DOOR_GOALS - 1 and room[goals[-1]] and through.any():
            apart = through
        apart = np.flatnonzero(apart)
        goals.append(int(apart[rng.integers(len(apart))]))
    return floor.places(cells[goals[1:]])


def check_goal(floor: Floor, goal: np.ndarray, name: str) -> None:
    """Raise InputError, with a name for the goal (2,) [m], if it is not on the floor that the robot has driven."""
    if not np.isfinite(goal).all():
        raise InputError(f"{name}: a goal is two finite numbers, X and Y [m]")
    if not floor.is_free(goal[None])[0]:
        away_m = np.linalg.norm(floor.places(np.argwhere(floor.free)) - goal, axis=1).min()
        raise InputError(f"{name}: the robot has driven no floor there; the nearest is {away_m:.2f} m away")
