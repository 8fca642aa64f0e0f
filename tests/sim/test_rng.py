"""RNG streams: each purpose has its own, which depends on the seed and its name alone."""

import numpy as np

from sim.rng import derive_seed, split, stream

NAMES = [("drive",), ("camera", "noise"), ("camera", "test_noise"), ("cameranoise",), ("weights", 0), ("weights", 1)]


def test_streams_of_other_seeds_and_names_are_uncorrelated():
    drawn = np.array([stream(seed, *name).standard_normal(20_000) for seed in (0, 1) for name in NAMES])
    apart = np.corrcoef(drawn) - np.eye(len(drawn))
    assert np.abs(apart).max() < 5 / np.sqrt(20_000)
    assert len({derive_seed(seed, *name) for seed in (0, 1) for name in NAMES}) == 2 * len(NAMES)


def test_a_part_of_a_stream_depends_on_its_name_and_not_on_what_was_drawn():
    parent = stream(3, "encoder")
    before = split(parent, "slip").random(5)
    parent.random(100)
    np.testing.assert_array_equal(split(parent, "slip").random(5), before)
    assert not np.isin(split(parent, "loss").random(5), before).any()
    assert not np.isin(split(stream(4, "encoder"), "slip").random(5), before).any()


def test_the_numbers_of_a_stream_are_those_of_older_recordings():
    for name, first in ((("drive",), 1913705580), (("camera", "noise"), 3619058549)):
        assert int(stream(0, *name).integers(2**32)) == first
