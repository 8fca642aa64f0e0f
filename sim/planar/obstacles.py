"""The lidar maps of the paper's appendix: a walled square with rectangular obstacles, and a point robot.

The robot drives straight until it comes near a wall or an obstacle, turns in a random direction and drives on. Now and
then it is relocated, because it would otherwise seldom find what is behind a narrow passage. Its observations are
scans: exact distances to walls and obstacles, all around. No MuJoCo.
"""

from pathlib import Path

import numpy as np
from scipy import ndimage

from sim.errors import InputError
from sim.geometry import spread_headings
from sim.occupancy import FreeSpace
from sim.planar.drive import record
from sim.recording.format import Report
from sim.rng import stream
from sim.sensors.lidar_scan import arrange, measure, ray_angles
from sim.settings import PLANE_CLEARANCE_M, PLANE_SIDE_M, SimSettings

OBSTACLES = 20
"""Rectangles to place; they may overlap, or leave passages."""
SMALLEST, LARGEST = 0.03, 0.2
"""Shortest and longest side of an obstacle, as fractions of the square's side."""
PASSAGE, TRIES = 0.06, 100
"""Smallest width of a passage between two obstacles, as a fraction of the square's side; draws per obstacle."""
CELLS = 200
"""Cells of the free space along a side."""
CHUNK = 16
"""Places whose rays are cast at once: few enough for a processor's cache."""
_TINY = 1e-9


class LidarWorld:
    """A walled square around the origin with obstacles in it.

    Attributes:
        box: Lower and upper corner of each obstacle (n, 2, 2) [m].
        bounds: Lower and upper corner of the square (2, 2) [m].
        segments: Straight segments to drive, at most.
        relocate_after: Segments after which the robot is relocated at random.
        space: Where the robot can be.
    """

    relocate_after = 10

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
        self.space = lay_free_space(self)

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot may be at ``points`` (..., 2) [m]."""
        at = np.asarray(points)[..., None, :]
        met = ((at > self._grown[:, 0]) & (at < self._grown[:, 1])).all(axis=-1).any(axis=-1)
        return ~met & ((at >= self._room[0]) & (at <= self._room[1])).all(axis=(-1, -2))

    def observe(self, poses: np.ndarray) -> np.ndarray:
        """Return exact scans (..., headings, rays) [m] from poses (..., 3)."""
        flat, angles = poses.reshape(-1, 3), ray_angles(self.lidar)
        scans = np.empty((len(flat), self.lidar.headings, self.lidar.rays), np.float32)
        for start in range(0, len(flat), CHUNK):
            pose = flat[start : start + CHUNK]
            distance = cast_rays(self.box, self.bounds, pose[:, :2], pose[:, 2:] + angles)
            scans[start : start + CHUNK] = arrange(distance, self.lidar)
        return scans.reshape(*poses.shape[:-1], *scans.shape[1:])

    def draw_start(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a random place (2,) [m] in the largest connected part of the free space."""
        row, column = rng.choice(np.argwhere(self.space.reachable))
        return self.space.origin + np.array([column, row]) * self.space.cell_m

    def way_ahead(self, place: np.ndarray, yaw: float) -> float:
        """Return the distance from a free place (2,) [m] along a heading [rad] until only the clearance is left [m]."""
        return float(cast_rays(self._grown, self._room, place[None], np.array([[yaw]]))[0, 0])


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report) -> None:
    """Make a recording of a lidar map, unless there is a complete one.

    Args:
        settings: Map, lidar, encoder, drive (speeds, spacing, samples) and test grid are used.
        seed: Seed of the RNG streams for map, driving, encoder and noise.
        folder: The recording's folder; complete once it holds ``manifest.json``.
        progress: Called with a stage (``drive``), the samples done and the largest number that there can be.

    Raises:
        InputError: There is no room for any test position.
    """
    if (folder / "manifest.json").is_file():
        return
    world, noise, turn_noise = LidarWorld(settings, seed), stream(seed, "lidar"), stream(seed, "lidar", "turn")
    grid = lay_grid(world, settings)

    def observe(poses: np.ndarray) -> np.ndarray:
        return measure(world.observe(poses), settings.lidar, noise)

    def observe_turn(poses: np.ndarray) -> np.ndarray:
        return measure(world.observe(poses), settings.lidar, turn_noise)

    truth = {"obstacle.npy": world.box}
    record(world, observe, observe_turn, grid, world.space, truth, settings, seed, folder, progress)


def place_obstacles(count: int, rng: np.random.Generator) -> np.ndarray:
    """Place random rectangles in a square of side 1 around the origin; return their lower and upper corners (n, 2, 2).

    Each overlaps every wall and placed rectangle, or leaves a passage to it; one for which ``TRIES`` draws fail is left
    out.
    """
    placed = np.empty((0, 2, 2))
    for _ in range(count):
        for _ in range(TRIES):
            middle, size = rng.uniform(-0.5, 0.5, 2), rng.uniform(SMALLEST, LARGEST, 2)
            box = np.stack([middle - size / 2, middle + size / 2])
            apart = np.maximum(placed[:, 0] - box[1], box[0] - placed[:, 1]).max(axis=1)
            gaps = np.concatenate([apart, box[0] + 0.5, 0.5 - box[1]])
            if not ((gaps > 0) & (gaps < PASSAGE)).any():
                placed = np.concatenate([placed, box[None]])
                break
    return placed


def cast_rays(box: np.ndarray, bounds: np.ndarray, place: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return distances along rays to the first box or to the wall, by the slab method (Kay and Kajiya 1986).

    A ray is inside a box while it is between both pairs of sides; it meets the box where it enters the second pair.

    Args:
        box: Lower and upper corners (n, 2, 2) [m].
        bounds: Lower and upper corner of the square within the walls (2, 2) [m].
        place: Where rays begin (p, 2) [m], in the square and, except for rounding errors, in no box.
        angle: Directions of the rays (p, m) [rad].

    Returns:
        Distances (p, m) [m].
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
        met = (enter <= leave) & (leave > _TINY)
        np.minimum(nearest, enter.clip(0.0), out=nearest, where=met)
    return nearest


def lay_free_space(world: LidarWorld) -> FreeSpace:
    """Return the cells where the robot may be; reachable is the largest connected part."""
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


def lay_grid(world: LidarWorld, settings: SimSettings) -> np.ndarray:
    """Return poses (C, H, 3) of the test grid: every reachable place, headings spread evenly from +x."""
    count = int(world.bounds[1, 0] / settings.grid.spacing_m)
    side = settings.grid.spacing_m * np.arange(-count, count + 1)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    points = points[world.is_free(points) & world.space.is_reachable(points)]
    if not len(points):
        raise InputError(f"grid.spacing_m {settings.grid.spacing_m} m leaves no test position between the obstacles")
    return spread_headings(points, settings.grid.headings)
