"""The map from which training starts, found without a network: rough ones by shortest paths, made exact, the best kept.

A rough map may have a nook, such as the room behind a sofa, turned over, or bent so far that its look-alikes are no
longer believed. Graphs of few and of many neighbours fail at different nooks, so some of each are tried, and judged by
how well bars and look-alikes fit one another. The truth has no part in it.
"""

import numpy as np
import torch

from deepgps.data import Segments
from deepgps.isomap import find_links, map_by_paths
from deepgps.pose_graph import relax

NEIGHBOURS = (3, 4, 6, 8)


def find_first_map(features: torch.Tensor, segments: Segments, generator: torch.Generator) -> np.ndarray:
    """Positions of observations with features (N, K), in a frame of its own.

    Returns:
        (N, 2) [m]; not a number for observations that hang together with few others.

    Raises:
        InputError: when the segments do not hang together.
    """
    graphs = find_links(features, segments, NEIGHBOURS)
    rough = [map_by_paths(len(features), segments, links, generator) for links in graphs]
    tries = [relax(places, segments, graphs[0]) for places in rough]
    places, _ = min(tries, key=lambda found: found[1])
    return places
