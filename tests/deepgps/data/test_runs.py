"""Stretches of a mask."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from deepgps.data.segments import fill_stretches, find_stretches


@given(st.lists(st.booleans(), max_size=40))
def test_a_mask_is_that_of_its_stretches(values: list[bool]):
    mask = np.array(values, bool)
    found = find_stretches(mask)
    assert (fill_stretches(found.tolist(), len(mask)) == mask).all()
    assert (found[1:, 0] > found[:-1, 1] + 1).all()


def test_a_stretch_ends_with_its_last_index():
    assert find_stretches(np.array([True, True, False, True])).tolist() == [[0, 1], [3, 3]]
