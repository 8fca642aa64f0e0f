"""Parts of a learned map that are mirrored or turned, by the compass: in a right map each turn is the one that it saw.

A folded map keeps the length of every segment but those that cross a fold, and places next to each other may look alike
all the same. Turns tell: in a part that lies mirrored, all of them go the other way. The truth is not used.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from deepgps.data.segments import find_runs
from deepgps.data.turns import compare_headings, find_in_place, take_images, turns_with_images
from sim.geometry import wrap
from sim.recording.format import Recording
from sim.recording.turns import Turns, from_array

AGREE_RAD = 0.35
"""A turn of the map agrees with the compass within this angle [rad]."""
SHORTEST_M = 0.3
"""Shorter segments have no direction that counts [m]."""
NEAR_M = 0.15
"""Segments that come so near to each other on the map belong to one part [m]."""
FEWEST = 3
"""Segments that a part has at least."""


@dataclass(frozen=True)
class TurnedParts:
    """What the compass says of a map.

    Attributes:
        share: Part of the way driven that lies in parts that are mirrored or turned.
        parts: Observations of each such part, the largest first.
        turns: Number of turns that were compared.
    """

    share: float
    parts: list[np.ndarray]
    turns: int


def find_turned_parts(positions: np.ndarray, recording: Recording) -> TurnedParts | None:
    """Compare the turns of a map with those that the images before and after them show.

    Args:
        positions: Predictions of the training observations (N, 2) [m], mirrored or not.
        recording: Of polar images.

    Returns:
        None without turn images.
    """
    if (turns := turns_with_images(recording)) is None:
        return None
    runs = [run for run in find_runs(recording) if len(run) >= 2]
    index = [recording.reading[run, 1] for run in runs]
    ends = np.array([positions[seen[-1]] - positions[seen[0]] for seen in index])
    length = np.linalg.norm(ends, axis=1)
    before, angle = _measure(recording, turns, runs)
    usable = (length[before] > SHORTEST_M) & (length[before + 1] > SHORTEST_M)
    before, angle = before[usable], angle[usable]
    heading = np.arctan2(ends[:, 1], ends[:, 0])
    turned = heading[before + 1] - heading[before]
    right = max((_agree(turned, sign * angle) for sign in (1.0, -1.0)), key=np.sum)
    votes, against = np.zeros(len(runs)), np.zeros(len(runs))
    for side in (0, 1):
        np.add.at(votes, before + side, 1)
        np.add.at(against, before + side, ~right)
    wrong = np.flatnonzero((votes > 0) & (against == votes))
    parts = [part for part in _group(wrong, index, positions) if len(part) >= FEWEST]
    share = length[np.concatenate([np.empty(0, int), *parts])].sum() / max(length.sum(), 1e-9)
    seen = [np.unique(np.concatenate([index[segment] for segment in part])) for part in parts]
    return TurnedParts(float(share), sorted(seen, key=len, reverse=True), len(before))


def describe_parts(found: TurnedParts | None) -> dict[str, Any]:
    """What ``metrics.json`` holds of them: the share of the way, the number of observations of each part, the turns."""
    if found is None:
        return {}
    return {
        "turned": {
            "share": round(found.share, 4),
            "parts": [len(part) for part in found.parts],
            "turns": found.turns,
        }
    }


def _measure(recording: Recording, turns: Turns, runs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Segments (T,) after which the robot turned in place, and the angles that the images show (T,) [rad]."""
    begins = {int(run[0]): number for number, run in enumerate(runs)}
    turns = from_array(turns.array[find_in_place(turns)])
    begun = np.array([begins.get(after, 0) for after in turns.after.tolist()], int)
    last = np.array([recording.reading[run[-1], 1] for run in runs])
    joined = (begun > 0) & (last[begun - 1] == turns.before)
    before, after = take_images(recording, from_array(turns.array[joined]))
    number = np.arange(len(before))
    headings = compare_headings(np.concatenate([before, after]), number, len(before) + number)
    return begun[joined][headings.clear] - 1, headings.turn[headings.clear]


def _agree(turned: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.abs(wrap(turned - angle)) < AGREE_RAD


def _group(wrong: np.ndarray, index: list[np.ndarray], positions: np.ndarray) -> list[np.ndarray]:
    """Segments of each part: those that follow one another, or come near to each other on the map."""
    if not len(wrong):
        return []
    owner = np.repeat(np.arange(len(wrong)), [len(index[segment]) for segment in wrong])
    near = KDTree(positions[np.concatenate([index[segment] for segment in wrong])]).query_pairs(
        NEAR_M, output_type="ndarray"
    )
    follows = np.flatnonzero(np.diff(wrong) == 1)
    one, other = np.append(owner[near[:, 0]], follows), np.append(owner[near[:, 1]], follows + 1)
    graph = csr_array((np.ones(len(one)), (one, other)), shape=(len(wrong), len(wrong)))
    count, part = connected_components(graph, directed=False)
    return [wrong[part == number] for number in range(count)]
