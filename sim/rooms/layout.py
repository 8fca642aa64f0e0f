"""Where things are: the floor and the walls of a room, and a search for places that a person would choose.

The floor is a grid of cells. Each piece occupies its footprint and keeps the floor before it open; it may be placed
only where a person can still walk from the door to everything that is used.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from sim.rooms.furniture.primitives import Footprint
from sim.rooms.outline import Wall, slabs

CELL_M = 0.05
CELL_SLACK = 0.41
"""Part of a cell by which a room may be larger than its cells: furniture against a wall is 2 cm away from it."""
PATH_RADIUS_M = 0.3  # Half the width that a person needs to walk
MAX_CUT_OFF_SHARE = 0.1
"""Walkable floor that is cut off from the door may be at most this fraction of the floor that is not."""
MAX_GAP_CELLS = 2  # Gaps between pieces may be at most this wide..
MIN_PASSAGE_CELLS = 7
"""...or at least this wide, enough for a broom; floor behind a gap in between counts as an unswept region."""
WALL_PROXIMITY_M = 0.3  # A piece nearer to a wall than this hides what hangs there


class Pose(NamedTuple):
    """Pose of a piece: the middle of its footprint [m] and its yaw [rad]; at yaw 0 it faces -y."""

    x: float
    y: float
    yaw: float

    @property
    def front(self) -> np.ndarray:
        """Direction that the piece faces (2,)."""
        return np.array((np.sin(self.yaw), -np.cos(self.yaw)))

    def ahead(self, forward_m: float, right_m: float = 0.0, turn_rad: float = 0.0) -> "Pose":
        """Return the pose at these distances before the piece and to its own right, turned by an angle."""
        s, c = float(np.sin(self.yaw)), float(np.cos(self.yaw))
        x, y = self.x + forward_m * s - right_m * c, self.y - forward_m * c - right_m * s
        return Pose(x, y, self.yaw + turn_rad)


Cost = Callable[[Pose], float]
"""Cost of a place, as a person would judge it [m]; the place with the lowest cost is tried first."""


class Layout:
    """The floor and the walls of a room with corners (V, 2) [m], counter-clockwise, and which parts are taken."""

    def __init__(self, corners: np.ndarray) -> None:
        self.corners = corners
        self.walls = [Wall(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        self.low = corners.min(axis=0)
        size = corners.max(axis=0) - self.low
        columns, rows = np.ceil(size / CELL_M - CELL_SLACK).astype(int)
        self.inside = np.zeros((rows, columns), bool)
        for left, right, bottom, top in slabs(corners):
            self.cells(left, right, bottom, top, self.inside)[:] = True
        self.taken = np.zeros_like(self.inside)
        self.kept = np.zeros_like(self.inside)
        self.overhead = ~self.inside
        self.tall = np.zeros(self.inside.shape)
        self.entrance: Pose | None = None
        self.cut_off = self.unswept = 0

    def against_wall(self, piece: Footprint, rng: np.random.Generator, cost: Cost | None = None) -> Pose | None:
        """Find a place with the back to a wall: roughly the cheapest or, without a cost, a random one."""
        poses = []
        for wall in self.walls:
            reach = (wall.length_m - piece.width_m) / 2 - 0.02
            if reach < 0:
                continue
            for x in np.linspace(-reach, reach, max(int(2 * reach / 0.1), 1) + 1):
                poses.append(wall_pose(wall, float(x), piece.depth_m / 2 + 0.02))
        return self._first_good(piece, poses, rng, cost)

    def in_the_open(
        self, piece: Footprint, rng: np.random.Generator, cost: Cost | None = None, turns: Sequence[float] = (0.0,)
    ) -> Pose | None:
        """Find a place anywhere on the floor, at one of the given turns."""
        rows, columns = np.nonzero(self.inside[::3, ::3])
        poses = [
            Pose(float(self.low[0] + 3 * c * CELL_M), float(self.low[1] + 3 * r * CELL_M), turn)
            for r, c in zip(rows, columns, strict=True)
            for turn in turns
        ]
        return self._first_good(piece, poses, rng, cost)

    def at(self, piece: Footprint, poses: Sequence[Pose], walkable: bool = True) -> Pose | None:
        """Return the first of the given places that is good."""
        return next((pose for pose in poses if self._good(piece, pose, walkable)), None)

    def take(self, piece: Footprint, pose: Pose) -> None:
        """Mark what a piece at a pose occupies and keeps open."""
        self.footprint(piece, pose, self.taken)[:] = True
        self._front(piece, pose, self.kept)[:] = True
        area = self.footprint(piece, pose, self.tall)
        area[:] = np.maximum(area, piece.height_m)
        for wall, rectangle in self._behind(piece, pose):
            wall.taken.append(rectangle)
        if self.entrance is not None:
            self.cut_off = self._walk(self.taken)[1]
            self.unswept = self._count_unswept(self.taken)

    def hang(
        self, wall: Wall, cover: tuple[float, float, float], rng: np.random.Generator, cost: Cost | None = None
    ) -> float | None:
        """Find x [m] on a wall where ``cover`` (width, bottom, top) overlaps nothing, and take it."""
        width, bottom, top = cover
        reach = (wall.length_m - width) / 2 - 0.05
        if reach < 0:
            return None
        places = rng.permutation(np.linspace(-reach, reach, max(int(2 * reach / 0.08), 1) + 1))
        if cost is not None:
            places = sorted(places, key=lambda x: cost(wall_pose(wall, x)))
        for x in places:
            rectangle = (x - width / 2 - 0.04, x + width / 2 + 0.04, bottom, top)
            if not any(_overlap(rectangle, other) for other in wall.taken):
                wall.taken.append(rectangle)
                return float(x)
        return None

    def keep_open(self, wall: Wall, x: float, width_m: float, depth_m: float) -> None:
        """Keep the floor before a place on a wall open, as before a door; the first such place is the entrance."""
        front = Footprint(width_m, depth_m, 0.0)
        self.footprint(front, wall_pose(wall, x, depth_m / 2), self.kept)[:] = True
        if self.entrance is None:
            self.entrance = wall_pose(wall, x, PATH_RADIUS_M + 2 * CELL_M)

    def overhang(self, size: tuple[float, float], rng: np.random.Generator, drop_m: float) -> np.ndarray | None:
        """Find a place (2,) on the ceiling for a fitting of ``size`` (x, y) that hangs down to ``drop_m``."""
        spread = 0.15
        piece = Footprint(size[0] + 2 * spread, size[1] + 2 * spread, 0.0)
        rows, columns = np.nonzero(self.inside[::4, ::4])
        for i in rng.permutation(len(rows)):
            pose = Pose(float(self.low[0] + 4 * CELL_M * columns[i]), float(self.low[1] + 4 * CELL_M * rows[i]), 0.0)
            if not self.is_inside(piece, pose) or self.footprint(piece, pose, self.overhead).any():
                continue
            if (self.footprint(piece, pose, self.tall) > drop_m).any():
                continue
            self.footprint(piece, pose, self.overhead)[:] = True
            return np.array((pose.x, pose.y))
        return None

    def clearance(self) -> np.ndarray:
        """Return the distance (rows, columns) from each cell to the nearest wall or piece [m]."""
        return _clearance(self.inside & ~self.taken)

    def cell(self, pose: Pose) -> tuple[int, int]:
        """Return row and column of the cell that contains a pose."""
        column, row = np.clip(
            (np.array((pose.x, pose.y)) - self.low) / CELL_M, 0, np.array(self.inside.shape[::-1]) - 1
        )
        return int(row), int(column)

    def is_floor(self, points: np.ndarray) -> np.ndarray:
        """Whether points (n, 2) [m] are on the floor: in the room and in no wall inside."""
        column, row = np.floor((points - self.low) / CELL_M + 0.01).astype(int).T
        rows, columns = self.inside.shape
        known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return known & self.inside[np.where(known, row, 0), np.where(known, column, 0)]

    def is_clear(self, piece: Footprint, pose: Pose) -> bool:
        """Whether a footprint is in the room on unoccupied floor, which may be floor that must stay open."""
        return self.is_inside(piece, pose) and not self.footprint(piece, pose, self.taken).any()

    def _first_good(
        self, piece: Footprint, poses: Sequence[Pose], rng: np.random.Generator, cost: Cost | None
    ) -> Pose | None:
        chance = rng.uniform(0.0, 0.25 if cost is not None else 1.0, len(poses))
        costs = [
            float(extra) + (cost(pose) if cost is not None else 0.0) for pose, extra in zip(poses, chance, strict=True)
        ]
        return self.at(piece, [poses[i] for i in np.argsort(costs, kind="stable")])

    def _good(self, piece: Footprint, pose: Pose, walkable: bool) -> bool:
        if not self.is_inside(piece, pose):
            return False
        if self.footprint(piece, pose, self.taken | self.kept).any():
            return False
        front = self._front(piece, pose, self.taken)
        if front.any():
            return False
        for wall, rectangle in self._behind(piece, pose):
            if any(_overlap(rectangle, other) for other in wall.taken):
                return False
        return not walkable or self._leaves_paths(piece, pose)

    def is_inside(self, piece: Footprint, pose: Pose) -> bool:
        """Whether a footprint is in the room, whatever else is there."""
        left, right, bottom, top = _rectangle(piece, pose)
        high = self.low + np.array(self.inside.shape[::-1]) * CELL_M
        tolerance = 1e-6
        if left < self.low[0] - tolerance or bottom < self.low[1] - tolerance:
            return False
        if right > high[0] + tolerance or top > high[1] + tolerance:
            return False
        return bool(self.footprint(piece, pose, self.inside).all())

    def _leaves_paths(self, piece: Footprint, pose: Pose) -> bool:
        """Whether a person can still walk to nearly all open floor and to the piece's front, and sweep the floor."""
        if self.entrance is None:
            return True
        taken = self.taken.copy()
        self.footprint(piece, pose, taken)[:] = True
        joined, cut_off = self._walk(taken)
        # If earlier pieces already cut off more floor than that, this one must not cut off any more.
        if not joined.any() or cut_off > max(MAX_CUT_OFF_SHARE * joined.sum(), self.cut_off):
            return False
        if self._count_unswept(taken) > self.unswept:
            return False
        if piece.front_m == 0.0:
            return True
        reachable = np.asarray(ndimage.distance_transform_edt(~joined)) * CELL_M <= PATH_RADIUS_M
        return bool(self._front(piece, pose, reachable).any())

    def _walk(self, taken: np.ndarray) -> tuple[np.ndarray, int]:
        """Return the cells to which a person can walk from the entrance, and the number of walkable cells cut off."""
        walkable = _clearance(self.inside & ~taken) > PATH_RADIUS_M - CELL_M / 2
        label = np.zeros(walkable.shape, np.int32)
        ndimage.label(walkable, output=label)
        first = 0 if self.entrance is None else label[self.cell(self.entrance)]
        joined = (label == first) & (first > 0)
        return joined, int(walkable.sum() - joined.sum())

    def _count_unswept(self, taken: np.ndarray) -> int:
        """Count the cells behind a gap that is too wide to count as closed and too narrow for a broom."""
        clear = self.inside & ~taken
        broom = ndimage.binary_erosion(clear, np.ones((MIN_PASSAGE_CELLS, MIN_PASSAGE_CELLS)))
        label = np.zeros(clear.shape, np.int32)
        ndimage.label(broom, output=label)
        first = 0 if self.entrance is None else label[self.cell(self.entrance)]
        swept = ndimage.binary_dilation((label == first) & (first > 0), np.ones((MIN_PASSAGE_CELLS, MIN_PASSAGE_CELLS)))
        open_floor = ndimage.binary_opening(clear, np.ones((MAX_GAP_CELLS + 1, MAX_GAP_CELLS + 1)))
        return int(np.logical_and(open_floor, np.logical_not(swept)).sum())

    def _behind(self, piece: Footprint, pose: Pose) -> list[tuple[Wall, tuple[float, float, float, float]]]:
        """Return the walls close to a piece, with the rectangle that it hides on each."""
        left, right, bottom, top = _rectangle(piece, pose)
        corners = np.array(((left, bottom), (right, bottom), (right, top), (left, top)))
        hidden = []
        for wall in self.walls:
            away = (corners - wall.middle) @ wall.normal
            x = (corners - wall.middle) @ wall.along
            beside = x.max() < -wall.length_m / 2 or x.min() > wall.length_m / 2
            if -0.01 < away.min() < WALL_PROXIMITY_M and not beside:
                hidden.append((wall, (float(x.min()), float(x.max()), 0.0, piece.height_m)))
        return hidden

    def footprint(self, piece: Footprint, pose: Pose, grid: np.ndarray) -> np.ndarray:
        """The part of a grid that a piece covers at a pose, as a view."""
        return self.cells(*_rectangle(piece, pose), grid)

    def _front(self, piece: Footprint, pose: Pose, grid: np.ndarray) -> np.ndarray:
        if piece.front_m == 0.0:
            return grid[:0]
        strip = Footprint(piece.width_m, piece.front_m, 0.0)
        return self.cells(*_rectangle(strip, pose.ahead((piece.depth_m + piece.front_m) / 2)), grid)

    def cells(self, left: float, right: float, bottom: float, top: float, grid: np.ndarray) -> np.ndarray:
        """The part of a grid that a rectangle [m] covers, as a view."""
        first = np.clip(np.floor((np.array((left, bottom)) - self.low) / CELL_M + 0.01).astype(int), 0, None)
        last = np.clip(np.ceil((np.array((right, top)) - self.low) / CELL_M - 0.01).astype(int), 0, None)
        return grid[first[1] : last[1], first[0] : last[0]]


def wall_pose(wall: Wall, x: float, off_m: float = 0.0) -> Pose:
    """Return the pose with its back to a wall at ``x`` along the wall, ``off_m`` into the room."""
    at = wall.middle + x * wall.along + off_m * wall.normal
    return Pose(float(at[0]), float(at[1]), wall.yaw)


def _clearance(clear: np.ndarray) -> np.ndarray:
    """Return the distance [m] from each cell to the nearest one that is not clear, or to the grid's edge."""
    return np.asarray(ndimage.distance_transform_edt(np.pad(clear, 1)))[1:-1, 1:-1] * CELL_M


def _rectangle(piece: Footprint, pose: Pose) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top [m] of the world-aligned rectangle around a footprint."""
    c, s = abs(np.cos(pose.yaw)), abs(np.sin(pose.yaw))
    x, y = (c * piece.width_m + s * piece.depth_m) / 2, (s * piece.width_m + c * piece.depth_m) / 2
    return pose.x - x, pose.x + x, pose.y - y, pose.y + y


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]
