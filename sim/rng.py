"""RNG streams: from one seed, an independent generator for each purpose, keyed by the purpose's name."""

import hashlib

import numpy as np


def stream(seed: int, *name: str | int) -> np.random.Generator:
    """Generator for one purpose; drawing from it never shifts another stream, and a new name changes none.

    A room draws from its own ``room.seed`` instead, so that the same room can be driven with many seeds. The name is
    words, or a word and a number, that no other purpose uses: ``("camera", "noise")``.
    """
    return np.random.default_rng(_key(np.random.SeedSequence(seed), name))


def split(rng: np.random.Generator, *name: str | int) -> np.random.Generator:
    """Generator for a part of a stream's purpose, by its name; it does not depend on what ``rng`` has drawn."""
    parent = rng.bit_generator.seed_seq
    assert isinstance(parent, np.random.SeedSequence)
    return np.random.default_rng(_key(parent, name))


def derive_seed(seed: int, *name: str | int) -> int:
    """A seed of 63 bits for one purpose, for generators that are not NumPy's and for drives of their own."""
    state = _key(np.random.SeedSequence(seed), name).generate_state(2, np.uint32)
    return int(state[0]) << 31 | int(state[1]) >> 1


def _key(parent: np.random.SeedSequence, name: tuple[str | int, ...]) -> np.random.SeedSequence:
    digest = hashlib.sha256("/".join(map(str, name)).encode()).digest()
    return np.random.SeedSequence(parent.entropy, spawn_key=(*parent.spawn_key, int.from_bytes(digest[:8])))
