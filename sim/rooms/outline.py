"""The outline of a room: its corners by shape, its walls, and the rectangles that make up its floor."""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from sim.settings import RoomShape

DIVIDER_M, DOORWAY_M = 0.3, 0.9  # Thickness of the wall between two rooms, and width of the doorway in it [m]
CORNER_GAP_M = 0.002


@dataclass(frozen=True, eq=False)
class Wall:
    """One straight wall; the room is on the left going from start to end."""

    start: np.ndarray  # First corner (2,) [m]
    end: np.ndarray  # Last corner (2,) [m]
    # Rectangles (left, right, bottom, top) [m] that are covered, in the wall's own frame: x runs along the wall from
    # its middle, as in the frame of a piece with its back to the wall
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    @cached_property
    def length_m(self) -> float:
        """Length of the wall [m]."""
        return float(np.abs(self.end - self.start).sum())

    @cached_property
    def middle(self) -> np.ndarray:
        """Middle of the wall (2,) [m]."""
        return (self.start + self.end) / 2

    @cached_property
    def normal(self) -> np.ndarray:
        """Direction (2,) into the room."""
        along = (self.end - self.start) / self.length_m
        return np.array((-along[1], along[0]))

    @cached_property
    def yaw(self) -> float:
        """Yaw of a piece with its back to this wall [rad]."""
        return float(np.arctan2(self.normal[0], -self.normal[1]))

    @cached_property
    def along(self) -> np.ndarray:
        """Direction (2,) of x in the wall's own frame."""
        return np.array((np.cos(self.yaw), np.sin(self.yaw)))

    def distance_m(self, point: np.ndarray) -> float:
        """Distance from a point (2,) to the wall [m]."""
        along = float(np.clip((point - self.middle) @ self.along, -self.length_m / 2, self.length_m / 2))
        return float(np.linalg.norm(point - self.middle - along * self.along))

    def overlap_m(self, following: "Wall", thickness_m: float) -> float:
        """How far this wall and the one that follows reach over their corner [m]: by their thickness past an outer one,
        while they end just short of an inner one, so that no two faces coincide."""
        (ax, ay), (bx, by) = self.end - self.start, following.end - following.start
        return thickness_m if ax * by > ay * bx else -CORNER_GAP_M


def outline(shape: RoomShape, width_m: float, depth_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return corners (V, 2) of a room around the origin, counter-clockwise [m]; cut-outs and doorways are random."""
    w, d = width_m / 2, depth_m / 2
    if shape == "l":
        x, y = w - rng.uniform(0.34, 0.42) * width_m, d - rng.uniform(0.34, 0.42) * depth_m
        corners = [(-w, -d), (w, -d), (w, y), (x, y), (x, d), (-w, d)]
    elif shape == "u":
        middle, half = rng.uniform(-0.06, 0.06) * width_m, rng.uniform(0.13, 0.16) * width_m
        y = d - rng.uniform(0.36, 0.44) * depth_m
        corners = [(-w, -d), (w, -d), (w, d), (middle + half, d), (middle + half, y)]
        corners += [(middle - half, y), (middle - half, d), (-w, d)]
    elif shape == "two_rooms":
        left = rng.uniform(-0.06, 0.06) * width_m - DIVIDER_M / 2
        right = left + DIVIDER_M
        low = rng.uniform(0.2 - d, d - 0.2 - DOORWAY_M)
        high = low + DOORWAY_M
        corners = [(-w, -d), (left, -d), (left, low), (right, low), (right, -d), (w, -d)]
        corners += [(w, d), (right, d), (right, high), (left, high), (left, d), (-w, d)]
    else:
        corners = [(-w, -d), (w, -d), (w, d), (-w, d)]
    points = np.array(corners)
    if shape in ("l", "u") and rng.random() < 0.5:
        points = -points
    return points


def slabs(corners: np.ndarray) -> list[tuple[float, float, float, float]]:
    """Divide the room into rectangles (left, right, bottom, top) [m] side by side along x."""
    found = []
    for left, right in pairwise(np.unique(corners[:, 0])):
        x = (left + right) / 2
        crossings = sorted(
            float(a[1])
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
            if min(a[0], b[0]) < x < max(a[0], b[0])
        )
        for bottom, top in zip(crossings[::2], crossings[1::2], strict=True):
            found.append((float(left), float(right), bottom, top))
    return found
