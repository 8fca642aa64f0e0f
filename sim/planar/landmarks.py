"""The paper's plane world (Sec. IV-A): a square with landmarks, seen as distances, and a point robot.

No MuJoCo: the robot drives straight until it meets a wall, turns in a random direction and drives on. Every
``drive.spacing_m`` it observes the distance to each landmark, a vector instead of an image.
"""

from pathlib import Path

import numpy as np

from sim.geometry import spread_headings
from sim.occupancy import FreeSpace
from sim.planar.drive import record
from sim.recording.format import Report
from sim.rng import stream
from sim.settings import PLANE_SIDE_M, SimSettings

CELL_M = 0.02
CHUNK = 1024
"""Poses whose distances are computed at once."""


class LandmarkWorld:
    """A square around the origin with landmarks in it.

    Attributes:
        landmark: Positions of the landmarks (M, 2) [m].
        bounds: Lower and upper corner (2, 2) [m].
        segments: Straight segments to drive.
        relocate_after: 0: the robot is never relocated.
    """

    relocate_after = 0

    def __init__(self, settings: SimSettings, seed: int) -> None:
        """Place the landmarks uniformly over the square."""
        self.settings = settings.landmarks
        self.segments = self.settings.segments
        half = PLANE_SIDE_M / 2
        self.bounds = np.array([[-half, -half], [half, half]])
        rng = stream(seed, "landmarks")
        self.landmark = rng.uniform(-half, half, (self.settings.count, 2))

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


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report) -> None:
    """Make a recording of the landmarks world, unless there is a complete one.

    Args:
        settings: Landmarks, encoder, drive (speeds, spacing, samples at most) and test grid are used.
        seed: Seed of the RNG streams for landmarks, driving and encoder.
        folder: The recording's folder; complete once it holds ``manifest.json``.
        progress: Called with a stage (``drive``), the samples done and the largest number that there can be.
    """
    if (folder / "manifest.json").is_file():
        return
    world = LandmarkWorld(settings, seed)
    truth = {"landmark.npy": world.landmark}
    grid, space = lay_grid(world, settings), lay_free_space(world)
    record(world, world.observe, None, grid, space, truth, settings, seed, folder, progress)


def lay_grid(world: LandmarkWorld, settings: SimSettings) -> np.ndarray:
    """Return poses (C, H, 3) of the test grid over the square, walls included, headings spread evenly from +x."""
    low, high = world.bounds[:, 0]
    side = np.linspace(low, high, max(round((high - low) / settings.grid.spacing_m), 1) + 1)
    return spread_headings(np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2), settings.grid.headings)


def lay_free_space(world: LandmarkWorld) -> FreeSpace:
    """Return the square as cells, all of them reachable, with a border of cells that are not."""
    low, high = world.bounds[:, 0]
    side = np.arange(round((high - low) / CELL_M) + 3)
    origin = np.full(2, low - CELL_M)
    inside = (side > 0) & (side < len(side) - 1)
    free = inside[:, None] & inside[None]
    return FreeSpace(origin, CELL_M, free, free.copy(), np.zeros(2), float(high - low))
