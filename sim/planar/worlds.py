"""The paper's plane worlds, without MuJoCo: a square with landmarks, and a walled square with obstacles.

In the landmarks world (Sec. IV-A) a point robot observes its distances to landmarks, a vector instead of an image. In
the lidar maps of the appendix it observes scans: exact distances to walls and rectangular obstacles, all around.
"""

import numpy as np
from scipy import ndimage

from sim.errors import InputError
from sim.geometry import FreeSpace, spread_headings
from sim.rng import stream
from sim.sensors.lidar_scan import arrange, measure, ray_angles
from sim.settings import PLANE_CLEARANCE_M, PLANE_SIDE_M, GridSettings, SimSettings

CELL_M, CHUNK = 0.02, 1024
"""Side of a cell of the landmarks world's free space [m], and poses whose distances are computed at once."""


class LandmarkWorld:
    """A square around the origin with ``landmark`` positions (M, 2) [m] in it, from which the robot is never relocated.

    An observation after a turn shows nothing that the one before does not. The square's cells are all reachable, with a
    border of cells that are not.
    """

    relocate_after, turn_images = 0, False

    def __init__(self, settings: SimSettings, seed: int) -> None:
        """Place the landmarks uniformly over the square."""
        self.settings = settings.landmarks
        self.segments = self.settings.segments
        half = PLANE_SIDE_M / 2
        self.bounds = np.array([[-half, -half], [half, half]])
        self.landmark = stream(seed, "landmarks").uniform(-half, half, (self.settings.count, 2))
        self.truth = {"landmark.npy": self.landmark}
        side = np.arange(round(PLANE_SIDE_M / CELL_M) + 3)
        inside = (side > 0) & (side < len(side) - 1)
        free = inside[:, None] & inside[None]
        self.space = FreeSpace(np.full(2, -half - CELL_M), CELL_M, free, free.copy(), np.zeros(2), PLANE_SIDE_M)

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether ``points`` (..., 2) [m] are in the square."""
        return np.all(np.abs(points) <= PLANE_SIDE_M / 2, axis=-1)

    def observe(self, poses: np.ndarray) -> np.ndarray:
        """Return distances (..., M) float32 [m] from poses (..., 3) to the landmarks, capped at the reach."""
        flat, reach_m = poses.reshape(-1, poses.shape[-1]), self.settings.reach_m or np.inf
        distance = np.empty((len(flat), len(self.landmark)), np.float32)
        for start in range(0, len(flat), CHUNK):
            apart = flat[start : start + CHUNK, None, :2] - self.landmark
            distance[start : start + CHUNK] = np.minimum(np.linalg.norm(apart, axis=-1), reach_m)
        return distance.reshape(*poses.shape[:-1], -1)

    def draw_start(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a random place (2,) [m]."""
        return rng.uniform(*self.bounds)

    def way_ahead(self, place: np.ndarray, yaw: float) -> float:
        """Return the distance from a place (2,) [m] in the square along a heading [rad] to the wall [m]."""
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        low, high = self.bounds
        room = np.where(direction > 0, high - place, place - low)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # infinite along a wall
            return float(np.nanmin(room / np.abs(direction)))

    def measure(self, poses: np.ndarray, turned: bool = False) -> np.ndarray:
        """Return what the robot's sensor shows at poses (..., 3): the exact distances."""
        return self.observe(poses)

    def lay_grid(self, grid: GridSettings) -> np.ndarray:
        """Return poses (C, H, 3) of the test grid over the square, walls included, headings spread evenly from +x."""
        low, high = self.bounds[:, 0]
        side = np.linspace(low, high, max(round((high - low) / grid.spacing_m), 1) + 1)
        return spread_headings(np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2), grid.headings)


OBSTACLES = 20  # Rectangles to place; they may overlap, or leave passages
MIN_OBSTACLE_SIDE, MAX_OBSTACLE_SIDE = 0.03, 0.2  # As fractions of the square's side
MIN_PASSAGE, TRIES = 0.06, 100
"""Smallest width of a passage between two obstacles, as a fraction of the square's side; draws per obstacle."""
CELLS, PLACES = 200, 16
"""Cells of the free space along a side, and places whose rays are cast at once: few enough for a processor's cache."""
_EPSILON = 1e-9


class LidarWorld:
    """A walled square around the origin with obstacles in it; ``box`` has their lower and upper corners (n, 2, 2) [m].

    The reachable cells are the largest connected part of those where the robot may be.
    """

    relocate_after, turn_images = 10, True  # segments between relocations; whether turns have observations

    def __init__(self, settings: SimSettings, seed: int) -> None:
        """Place the obstacles uniformly over the square, from the settings' own seed if given, else from ``seed``."""
        self.lidar, own_seed = settings.lidar, settings.obstacles.seed
        side = PLANE_SIDE_M
        self.bounds = np.array([[-side, -side], [side, side]]) / 2
        self.segments = settings.drive.samples  # each segment gives several samples
        rng = stream(seed if own_seed is None else own_seed, "map")
        self.box = side * place_obstacles(OBSTACLES, rng)
        # The point robot must stay out of the obstacles grown, and in the square shrunk, by the clearance.
        grow = np.array([[-1.0], [1.0]]) * PLANE_CLEARANCE_M
        self._grown, self._room = self.box + grow, self.bounds - grow
        self.space = _lay_free_space(self)
        self.truth = {"obstacle.npy": self.box}
        self._noise, self._turn_noise = stream(seed, "lidar"), stream(seed, "lidar", "turn")

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot may be at ``points`` (..., 2) [m]."""
        at = np.asarray(points)[..., None, :]
        met = ((at > self._grown[:, 0]) & (at < self._grown[:, 1])).all(axis=-1).any(axis=-1)
        return ~met & ((at >= self._room[0]) & (at <= self._room[1])).all(axis=(-1, -2))

    def observe(self, poses: np.ndarray) -> np.ndarray:
        """Return exact scans (..., headings, rays) [m] from poses (..., 3)."""
        flat, angles = poses.reshape(-1, 3), ray_angles(self.lidar)
        scans = np.empty((len(flat), self.lidar.headings, self.lidar.rays), np.float32)
        for start in range(0, len(flat), PLACES):
            pose = flat[start : start + PLACES]
            distance = cast_rays(self.box, self.bounds, pose[:, :2], pose[:, 2:] + angles)
            scans[start : start + PLACES] = arrange(distance, self.lidar)
        return scans.reshape(*poses.shape[:-1], *scans.shape[1:])

    def draw_start(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a random place (2,) [m] in the largest connected part of the free space."""
        return rng.choice(self.space.places())

    def way_ahead(self, place: np.ndarray, yaw: float) -> float:
        """Return the distance from a free place (2,) [m] along a heading [rad] until only the clearance is left [m]."""
        return float(cast_rays(self._grown, self._room, place[None], np.array([[yaw]]))[0, 0])

    def measure(self, poses: np.ndarray, turned: bool = False) -> np.ndarray:
        """Return what the lidar measures at poses (..., 3), which are those after turns if ``turned``."""
        return measure(self.observe(poses), self.lidar, self._turn_noise if turned else self._noise)

    def lay_grid(self, grid: GridSettings) -> np.ndarray:
        """Return poses (C, H, 3) of the test grid: every reachable place, headings spread evenly from +x.

        Raises InputError if there is no room for any test position.
        """
        count = int(self.bounds[1, 0] / grid.spacing_m)
        side = grid.spacing_m * np.arange(-count, count + 1)
        points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        points = points[self.is_free(points) & self.space.is_reachable(points)]
        if not len(points):
            raise InputError(f"grid.spacing_m {grid.spacing_m} m leaves no test position between the obstacles")
        return spread_headings(points, grid.headings)


def place_obstacles(count: int, rng: np.random.Generator) -> np.ndarray:
    """Place random rectangles in a square of side 1 around the origin; return their lower and upper corners (n, 2, 2).

    Each overlaps every wall and placed rectangle, or leaves a passage to it; one for which ``TRIES`` draws fail is left
    out.
    """
    placed = np.empty((0, 2, 2))
    for _ in range(count):
        for _ in range(TRIES):
            middle, size = rng.uniform(-0.5, 0.5, 2), rng.uniform(MIN_OBSTACLE_SIDE, MAX_OBSTACLE_SIDE, 2)
            box = np.stack([middle - size / 2, middle + size / 2])
            apart = np.maximum(placed[:, 0] - box[1], box[0] - placed[:, 1]).max(axis=1)
            gaps = np.concatenate([apart, box[0] + 0.5, 0.5 - box[1]])
            if not ((gaps > 0) & (gaps < MIN_PASSAGE)).any():
                placed = np.concatenate([placed, box[None]])
                break
    return placed


def cast_rays(box: np.ndarray, bounds: np.ndarray, place: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return distances along rays to the first box or to the wall, by the slab method (Kay and Kajiya 1986).

    A ray is inside a box while it is between both pairs of sides; it meets the box where it enters the second pair.
    From corners (n, 2, 2) of boxes and (2, 2) of the walls, places (p, 2) in no box [m] and angles (p, m) [rad], the
    distances are (p, m) [m].
    """
    direction = np.stack([np.cos(angle), np.sin(angle)])
    # A ray parallel to a slab never leaves it, or never enters it; it never meets the walls along it.
    parallel = np.abs(direction) < 1e-12
    per_metre = 1.0 / np.where(parallel, 1e-12, direction)
    wall = np.where(direction > 0, bounds[1, :, None, None], bounds[0, :, None, None])
    nearest = np.where(parallel, np.inf, (wall - place.T[..., None]) * per_metre).min(axis=0).clip(0.0)
    for low, high in box:
        one, other = (low[:, None] - place.T)[..., None] * per_metre, (high[:, None] - place.T)[..., None] * per_metre
        enter = np.minimum(one, other).max(axis=0)
        leave = np.maximum(one, other).min(axis=0)
        met = (enter <= leave) & (leave > _EPSILON)
        np.minimum(nearest, enter.clip(0.0), out=nearest, where=met)
    return nearest


def _lay_free_space(world: LidarWorld) -> FreeSpace:
    cell = PLANE_SIDE_M / CELLS
    side = world.bounds[0, 0] + cell * np.arange(CELLS + 1)
    free = world.is_free(np.stack(np.meshgrid(side, side), axis=-1))
    part = np.zeros(free.shape, np.int32)
    ndimage.label(free, output=part)
    size = np.bincount(part.ravel())[1:]
    reachable = part == 1 + size.argmax()
    row, column = np.nonzero(reachable)
    extent = min(np.ptp(row), np.ptp(column)) * cell + 2 * PLANE_CLEARANCE_M
    start = world.bounds[0] + cell * np.array([column[0], row[0]])
    return FreeSpace(world.bounds[0].copy(), cell, free, reachable, start, float(extent))
