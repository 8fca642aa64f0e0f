"""The map from which training starts, found without a network: rough maps, each relaxed, the best kept and refined.

Maps by shortest paths are bent by furniture, which may mirror a region; maps by straightness need bars that cross
often. So both are tried, and judged by how well segments and loop closures fit one another, and by whether places that
look unlike lie on top of one another. The ground truth is not used.
"""

import numpy as np
import torch

from deepgps.data.segments import Segments
from deepgps.initial_map.distances.affine_maps import find_affine_maps
from deepgps.initial_map.distances.folding import measure_overlap
from deepgps.initial_map.distances.isomap import NEIGHBOURS, find_loop_closures, map_by_paths
from deepgps.initial_map.distances.pose_graph import relax
from deepgps.initial_map.distances.uneven_bars import relax_unevenly

OVERLAP = 0.1
"""Part of the observations that look unlike their neighbours on the map which counts as much as the whole cost."""


def find_initial_map(
    features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> tuple[np.ndarray, Segments]:
    """Positions of observations with features (N, K), in an arbitrary frame.

    Returns:
        (N, 2) [m]; NaN for observations outside the largest connected part. And the segments, with the distances that
        their readings have on this map: those of the encoders, as far as these are exact.

    Raises:
        InputError: The segments are not connected.
    """
    graphs = find_loop_closures(features, segments, NEIGHBOURS)
    rough = [map_by_paths(len(features), segments, closures, generator) for closures in graphs]
    rough += find_affine_maps(len(features), segments, graphs[0])
    same = generator.get_state()

    def judge(found: tuple[np.ndarray, float]) -> float:
        places, cost = found
        return cost * (1.0 + measure_overlap(places, features, segments, generator.set_state(same)) / OVERLAP)

    best = min((relax(places, segments, graphs[0]) for places in rough), key=judge)[0]
    relaxed = relax_unevenly(best, segments, graphs[0], np.random.default_rng(generator.initial_seed()))
    return relaxed.places, relaxed.segments
