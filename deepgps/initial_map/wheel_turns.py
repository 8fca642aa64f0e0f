"""Turns by the wheels: a path that starts the map, and which of two mirrored maps is the room's. Never the truth.

Distances along segments cannot tell left from right; the difference of the wheels' ways between two segments can, and
is enough for it even where encoders slip so far that the path itself is lost.
"""

from dataclasses import dataclass

import numpy as np
import torch

from deepgps.data.dead_reckoning import dead_reckon
from deepgps.data.segments import Segments, find_runs
from deepgps.initial_map.dense import NEIGHBOURS
from deepgps.initial_map.isomap import find_loop_closures
from deepgps.initial_map.pose_graph import relax
from sim.recording.format import Recording


@dataclass(frozen=True)
class Turns:
    """What the wheels say of a whole drive.

    Attributes:
        path: Dead-reckoned place of each observation (N, 2) [m]; not a number where no reading arrived.
        angle: Turn from each segment to the next, to the left (L - 1,) [rad]; segments as in ``Segments``.
    """

    path: np.ndarray
    angle: np.ndarray


def read_turns(recording: Recording) -> Turns:
    """Path and turns of a recording by its wheels."""
    pose, observation = dead_reckon(recording), recording.reading[:, 1]
    seen, first = np.unique(observation, return_index=True)
    path = np.full((len(recording.observation), 2), np.nan)
    path[seen] = pose[first, :2]
    heading = np.array([pose[run, 2].mean() for run in find_runs(recording) if len(run) >= 2])
    return Turns(path, np.diff(heading))


def straighten(turns: Turns, chosen: torch.Tensor, features: torch.Tensor, segments: Segments) -> np.ndarray:
    """Positions (n, 2) [m] of the chosen observations: the path, moved until segments that look alike fit one another.

    Args:
        turns: Path by the wheels.
        chosen: Observations (n,).
        features: Features of them (n, K).
        segments: Weak constraints, which number them from 0.
    """
    return relax(turns.path[chosen.numpy()], segments, find_loop_closures(features, segments, NEIGHBOURS[:1])[0])[0]


def find_chirality(positions: np.ndarray, segments: Segments, turns: Turns) -> int:
    """1 where the turns of a map go the way that the wheels turned, -1 where the map is mirrored.

    Args:
        positions: Predictions of all training observations (N, 2) [m].
        segments: Weak constraints.
        turns: What the wheels turned.
    """
    rows = torch.arange(len(segments.count))
    last = segments.index[rows, segments.count - 1].numpy()
    x, y = (positions[last] - positions[segments.index[:, 0].numpy()]).T
    mapped = np.diff(np.arctan2(y, x))
    # Half turns say nothing of left and right; turns of a quarter say most.
    return 1 if (np.sin(mapped) * np.sin(turns.angle)).sum() >= 0.0 else -1
