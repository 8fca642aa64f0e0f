"""The paper's plane world (Sec. IV-A): a square with landmarks, seen as distances, and a robot that is a point.

No MuJoCo: the robot drives straight until it meets a wall, turns by chance and drives on. It observes every
``drive.spacing_m`` the distance to each landmark, a vector in place of an image.
"""

from pathlib import Path

import numpy as np

from sim.occupancy import FreeSpace
from sim.planar.drive import Report, record, spread_headings
from sim.rng import stream
from sim.settings import SimSettings

CELL_M = 0.02


class LandmarkWorld:
    """A square about the origin with landmarks in it.

    Attributes:
        landmark: Where they stand (M, 2) [m].
        bounds: Lower and upper corner (2, 2) [m].
        segments: Straight segments to drive.
        relocate_after: The robot never is.
    """

    relocate_after = 0

    def __init__(self, settings: SimSettings, seed: int) -> None:
        """Place the landmarks uniformly over the square, from the settings' own seed or else from this one."""
        self.settings = settings.landmarks
        self.segments = self.settings.segments
        half = self.settings.side_m / 2
        self.bounds = np.array([[-half, -half], [half, half]])
        rng = stream(seed if self.settings.seed is None else self.settings.seed, "landmarks")
        self.landmark = rng.uniform(-half, half, (self.settings.count, 2))

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether ``points`` (..., 2) [m] lie in the square."""
        return np.all(np.abs(points) <= self.settings.side_m / 2, axis=-1)

    def observe(self, poses: np.ndarray) -> np.ndarray:
        """Distances (..., M) float32 [m] from poses (..., 3) to the landmarks; the reach for what lies beyond it."""
        distance = np.linalg.norm(poses[..., None, :2] - self.landmark, axis=-1)
        return np.minimum(distance, self.settings.reach_m or np.inf).astype(np.float32)

    def draw_start(self, rng: np.random.Generator) -> np.ndarray:
        """A random place (2,) [m]."""
        return rng.uniform(*self.bounds)

    def way_ahead(self, place: np.ndarray, yaw: float) -> float:
        """Way from a place (2,) [m] in the square along a heading [rad] to the wall [m]."""
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        low, high = self.bounds
        room = np.where(direction > 0, high - place, place - low)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # along a wall the way to it is infinite
            return float(np.nanmin(room / np.abs(direction)))


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report) -> None:
    """Make a recording of the landmarks world, or leave the finished one that stands.

    Args:
        settings: Landmarks, encoder, drive (speeds, spacing, samples at most) and test grid are used.
        seed: Landmarks, driving and encoder draw from streams of this number.
        folder: The recording's folder; finished once it holds ``manifest.json``.
        progress: Told how far it is, in samples of the most that there can be.
    """
    if (folder / "manifest.json").is_file():
        return
    world = LandmarkWorld(settings, seed)
    truth = {"landmark.npy": world.landmark}
    grid, space = lay_grid(world, settings), lay_free_space(world)
    record(world, world.observe, grid, space, truth, settings, seed, folder, progress)


def lay_grid(world: LandmarkWorld, settings: SimSettings) -> np.ndarray:
    """Poses (C, H, 3) of the test grid over the square, walls included, headings spread evenly from +x."""
    low, high = world.bounds[:, 0]
    side = np.linspace(low, high, round((high - low) / settings.grid.spacing_m) + 1)
    return spread_headings(np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2), settings.grid.headings)


def lay_free_space(world: LandmarkWorld) -> FreeSpace:
    """The square as cells, all of it reachable, with a rim of cells that are not."""
    low, high = world.bounds[:, 0]
    side = np.arange(round((high - low) / CELL_M) + 3)
    origin = np.full(2, low - CELL_M)
    inside = (side > 0) & (side < len(side) - 1)
    free = inside[:, None] & inside[None]
    return FreeSpace(origin, CELL_M, free, free.copy(), np.zeros(2), float(high - low))
