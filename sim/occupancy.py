"""Which cells of a floor the robot's centre can reach."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.files.checksums import damaged, read_arrays, write_arrays


@dataclass(frozen=True)
class FreeSpace:
    """Where the robot fits, on a grid of cells.

    Attributes:
        origin: World position of the middle of cell ``[0, 0]`` (2,) [m].
        cell_m: Side of a cell [m].
        free: (rows, columns) bool, rows along y, columns along x: True where the robot's centre may be.
        reachable: The part of ``free`` that is connected to the start.
        start: Where the robot starts (2,) [m].
        shorter_side_m: Shorter side of the bounding box of the enclosed free space, wall to wall [m].
    """

    origin: np.ndarray
    cell_m: float
    free: np.ndarray
    reachable: np.ndarray
    start: np.ndarray
    shorter_side_m: float

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot fits with its centre at ``points`` (..., 2) [m]."""
        return self._look_up(self.free, points)

    def is_reachable(self, points: np.ndarray) -> np.ndarray:
        """Whether the robot can get from its start to ``points`` (..., 2) [m]."""
        return self._look_up(self.reachable, points)

    def _look_up(self, mask: np.ndarray, points: np.ndarray) -> np.ndarray:
        cell = np.rint((np.asarray(points) - self.origin) / self.cell_m).astype(int)
        column, row = cell[..., 0], cell[..., 1]
        inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        return inside & mask[np.where(inside, row, 0), np.where(inside, column, 0)]


def save_free_space(path: Path, space: FreeSpace) -> None:
    """Write the free space as one ``.npz`` file."""
    write_arrays(
        path,
        {
            "origin": np.asarray(space.origin, float),
            "cell_m": np.array(space.cell_m),
            "free": space.free,
            "reachable": space.reachable,
            "start": np.asarray(space.start, float),
            "shorter_side_m": np.array(space.shorter_side_m),
        },
    )


def load_free_space(path: Path) -> FreeSpace:
    """Read the free space; raises DamagedError."""
    data = read_arrays(path)
    try:
        return FreeSpace(
            origin=data["origin"],
            cell_m=float(data["cell_m"]),
            free=data["free"],
            reachable=data["reachable"],
            start=data["start"],
            shorter_side_m=float(data["shorter_side_m"]),
        )
    except KeyError as error:
        raise damaged(path, f"it has no array {error}") from None


def limits(space: FreeSpace, margin_m: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """South-west and north-east corners (2,) [m] of the reachable area plus a margin."""
    row, column = np.nonzero(space.reachable)
    corner = np.array([[column.min(), row.min()], [column.max(), row.max()]])
    low, high = space.origin + corner * space.cell_m
    return low - margin_m, high + margin_m
