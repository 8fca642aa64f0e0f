"""Turns measured by the wheels: a path to start the map from, and the choice between two mirrored maps.

Distances along segments leave a mirror ambiguity. The difference of the distances that the two wheels travel between
segments resolves it, even where encoders slip so far that the path itself is useless. The ground truth is not used.
"""

from dataclasses import dataclass

import numpy as np
import torch

from deepgps.data.segments import Segments, dead_reckon, find_runs
from deepgps.initial_map.distances.isomap import NEIGHBOURS, find_loop_closures
from deepgps.initial_map.distances.pose_graph import relax
from deepgps.initial_map.distances.uneven_bars import Relaxed, relax_unevenly
from sim.recording.format import Recording


@dataclass(frozen=True)
class WheelTurns:
    """Path and turns of a complete drive, measured by the wheels.

    Attributes:
        path: Dead-reckoned position of each observation (N, 2) [m]; NaN where no reading arrived.
        angle: Turn from each segment to the next, to the left (L - 1,) [rad]; segments as in ``Segments``.
    """

    path: np.ndarray
    angle: np.ndarray


def read_turns(recording: Recording) -> WheelTurns:
    """Read the path and turns of a recording, measured by its wheels."""
    pose, observation = dead_reckon(recording), recording.reading[:, 1]
    seen, first = np.unique(observation, return_index=True)
    path = np.full((len(recording.observation), 2), np.nan)
    path[seen] = pose[first, :2]
    heading = np.array([pose[run, 2].mean() for run in find_runs(recording) if len(run) >= 2])
    return WheelTurns(path, np.diff(heading))


def straighten(turns: WheelTurns, features: torch.Tensor, segments: Segments, rng: np.random.Generator) -> Relaxed:
    """The path, relaxed until segments and loop closures fit.

    Args:
        turns: The wheels' path.
        features: Features of the observations (N, K).
        segments: Weak constraints.
        rng: Draws samples for the noise of the encoders.
    """
    closures = find_loop_closures(features, segments, NEIGHBOURS[:1])[0]
    return relax_unevenly(relax(turns.path, segments, closures)[0], segments, closures, rng)


def find_chirality(positions: np.ndarray, segments: Segments, angle: np.ndarray) -> int:
    """Return 1 if the turns of a map have the direction of those measured, -1 if the map is mirrored.

    Args:
        positions: Predictions of all training observations (N, 2) [m].
        segments: Weak constraints.
        angle: Turn from each segment to the next, to the left (L - 1,), by wheels or compass [rad].
    """
    rows = torch.arange(len(segments.count))
    last = segments.index[rows, segments.count - 1].numpy()
    x, y = (positions[last] - positions[segments.index[:, 0].numpy()]).T
    mapped = np.diff(np.arctan2(y, x))
    # Half turns carry no information about left and right; quarter turns carry the most.
    return 1 if (np.sin(mapped) * np.sin(angle)).sum() >= 0.0 else -1
