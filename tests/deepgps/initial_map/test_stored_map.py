"""The map's file: read back as it was found, with the stages of its making."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.initial_map.compass.compass_map import MAX_STAGES
from deepgps.initial_map.stored_map import FILE, read_map, write_map
from sim.errors import DamagedError
from tests.deepgps.initial_map.compass.test_compass_map import drive, error, find_map


def test_a_map_is_read_back_with_all_its_stages(tmp_path: Path):
    made = drive(100, noise=1.0)
    found = find_map(made)
    write_map(tmp_path, found, made.segments, made.turns)
    stored = read_map(tmp_path)
    assert stored is not None
    np.testing.assert_array_equal(stored.places, found.places)
    np.testing.assert_allclose(stored.expected, np.sqrt(2.0) * found.std)
    np.testing.assert_array_equal(stored.closure[:, 1], made.closures.second)
    np.testing.assert_array_equal(stored.turn_angle, made.turns.angle)
    apart = made.place[stored.turn[:, 1]] - made.place[stored.turn[:, 0]]
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)  # segments meet where the robot turned
    first, last = found.stages[0], found.stages[-1]  # from as laid out to the map
    assert not first.inliers.any() and error(first.places, made.place) > 2.0 * error(found.places, made.place)
    np.testing.assert_allclose(last.places, found.places, atol=1e-5)
    np.testing.assert_allclose(last.heading, found.heading, atol=1e-5)
    assert 2 <= len(stored.stage) <= MAX_STAGES and stored.stage[0] == 0 and (np.diff(stored.stage) > 0).all()


def test_a_method_without_map_has_none_and_a_damaged_one_is_told(tmp_path: Path):
    assert read_map(tmp_path) is None
    made = drive(10)
    write_map(tmp_path, find_map(made), made.segments, made.turns)
    (tmp_path / FILE).write_bytes((tmp_path / FILE).read_bytes()[:-100])
    with pytest.raises(DamagedError, match=r"map\.npz is damaged"):
        read_map(tmp_path)
