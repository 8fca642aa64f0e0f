"""RNG streams: from one seed, an independent generator for each purpose."""

from typing import Literal, get_args

import numpy as np

Stream = Literal["drive", "encoder", "camera", "weights", "shuffling", "landmarks", "map", "lidar"]


def stream(seed: int, name: Stream) -> np.random.Generator:
    """Generator for one purpose; drawing from it never shifts another stream.

    A room draws from its own ``room.seed`` instead, so that the same room can be driven with many seeds.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(get_args(Stream).index(name),)))
