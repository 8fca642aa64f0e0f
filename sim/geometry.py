"""Poses on the floor, and which cells of it the robot can reach."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sim.files.checksums import damaged, read_arrays, write_arrays

Angle = TypeVar("Angle", float, np.ndarray)


def planar_pose(qpos: np.ndarray) -> np.ndarray:
    """Planar pose (..., 3) x, y [m], yaw [rad] of full positions (..., nq): the robot's free joint comes first."""
    x, y, _, w, i, j, k = np.moveaxis(np.asarray(qpos, float)[..., :7], -1, 0)
    return np.stack([x, y, np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))], axis=-1)


def spread_headings(points: np.ndarray, headings: int) -> np.ndarray:
    """Poses (C, H, 3) at points (C, 2) [m], with headings spread evenly from +x."""
    yaw = np.broadcast_to(2 * np.pi * np.arange(headings)[:, None] / headings, (len(points), headings, 1))
    return np.concatenate([points[:, None].repeat(headings, axis=1), yaw], axis=-1)


def wrap(angle: Angle) -> Angle:
    """The same angles [rad] between -pi and pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


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

    def places(self) -> np.ndarray:
        """Middles (n, 2) [m] of the cells that can be reached."""
        row, column = np.nonzero(self.reachable)
        return self.origin + self.cell_m * np.stack([column, row], axis=1)

    def _look_up(self, mask: np.ndarray, points: np.ndarray) -> np.ndarray:
        cell = np.rint((np.asarray(points) - self.origin) / self.cell_m).astype(int)
        column, row = cell[..., 0], cell[..., 1]
        inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        return inside & mask[np.where(inside, row, 0), np.where(inside, column, 0)]


def save_free_space(path: Path, space: FreeSpace) -> None:
    """Write the free space as one ``.npz`` file."""
    write_arrays(path, {name: np.asarray(value) for name, value in vars(space).items()})


def load_free_space(path: Path) -> FreeSpace:
    """Read the free space; raises DamagedError."""
    data: dict[str, Any] = {name: array if array.ndim else array.item() for name, array in read_arrays(path).items()}
    if missing := FreeSpace.__dataclass_fields__.keys() - data.keys():
        raise damaged(path, f"it has no array {min(missing)}")
    return FreeSpace(**{name: data[name] for name in FreeSpace.__dataclass_fields__})


def limits(space: FreeSpace, margin_m: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """South-west and north-east corners (2,) [m] of the reachable area plus a margin."""
    places = space.places()
    return places.min(axis=0) - margin_m, places.max(axis=0) + margin_m
