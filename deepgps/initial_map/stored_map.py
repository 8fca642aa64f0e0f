"""A map by compass in a method's folder, ``map.npz``: what evaluation measures and the viewer shows of its making.

It is no part of what positions an image: it is written before the training and never read by it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepgps.data.segments import Segments
from deepgps.data.turns import CompassTurns
from deepgps.initial_map.compass.compass_map import CompassMap
from sim.files.checksums import read_arrays, write_arrays

FILE = "map.npz"


@dataclass(frozen=True)
class StoredMap:
    """A map by compass, with k stages of its making, n loop closures and L - 1 turns."""

    places: np.ndarray  # Positions of the camera at the observations (N, 2) [m]; NaN where they are unknown
    heading: np.ndarray  # Heading of the robot at each (N,) [rad]
    covariance: np.ndarray  # Of each position's error, after alignment of the whole map (N, 2, 2) [m^2]
    samples: np.ndarray  # Number of samples that each covariance is the mean of ()
    undecided: np.ndarray  # Observations that may lie elsewhere (N,) bool
    closure: np.ndarray  # The two observations of each loop closure (n, 2)
    closure_turn: np.ndarray  # Angle from the first's heading to the second's, to the left (n,) [rad]; NaN: open
    turn: np.ndarray  # Last observation before and first observation after each turn (L - 1, 2)
    turn_angle: np.ndarray  # Turn to the left (L - 1,) [rad]
    turn_std: np.ndarray  # Its standard deviation (L - 1,) [rad]
    stage: np.ndarray  # Rounds before each stage (k,); 0: as laid out along the compass headings
    stage_places: np.ndarray  # Positions at each stage (k, N, 2) float32 [m]
    stage_heading: np.ndarray  # Headings at each stage (k, N) float32 [rad]
    stage_believed: np.ndarray  # Inliers among the loop closures at each stage (k, n) bool

    @property
    def known(self) -> np.ndarray:
        """Whether each observation has a position (N,) bool."""
        return np.isfinite(self.places[:, 0])

    @property
    def expected(self) -> np.ndarray:
        """Expected distance of each position from the truth, as RMS (N,) [m]: the root of the covariance's trace."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))


def write_map(folder: Path, found: CompassMap, segments: Segments, turns: CompassTurns) -> None:
    """Write a map of these segments and the turns between them into a method's folder."""
    samples = found.error.shape[2]
    rows = np.arange(len(segments.count))
    last = segments.index.numpy()[rows, segments.count.numpy() - 1]
    stored = StoredMap(
        places=found.places,
        heading=found.heading,
        covariance=np.einsum("nas,nbs->nab", found.error, found.error) / samples,
        samples=np.array(samples),
        undecided=found.undecided,
        closure=np.stack([found.closures.first, found.closures.second], axis=1),
        closure_turn=found.closures.turn,
        turn=np.stack([last[:-1], segments.index.numpy()[1:, 0]], axis=1),
        turn_angle=turns.angle,
        turn_std=turns.angle_std,
        stage=np.array([stage.number for stage in found.stages]),
        stage_places=np.stack([stage.places for stage in found.stages]),
        stage_heading=np.stack([stage.heading for stage in found.stages]),
        stage_believed=np.stack([stage.inliers for stage in found.stages]),
    )
    write_arrays(folder / FILE, vars(stored))


def read_map(folder: Path) -> StoredMap | None:
    """Read the map of a method's folder; None: it has none, as other methods. Raises DamagedError if it is damaged."""
    path = folder / FILE
    return StoredMap(**read_arrays(path)) if path.is_file() else None
