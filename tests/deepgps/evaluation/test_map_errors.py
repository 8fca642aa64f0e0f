"""Errors of an initial map beside its own covariance: laws of the measure, and theory that grows with the noise."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.map_errors import (
    find_true_camera,
    is_undecided,
    judge_map,
    measure_nees,
    place_map,
)
from deepgps.initial_map.stored_map import StoredMap, read_map, write_map
from sim.recording.format import Recording, Truth
from tests.deepgps.initial_map.compass.test_compass_map import drive, find_map

TURN = np.array([[0.6, -0.8], [0.8, 0.6]])
FIELD = ErrorField(np.array([[1.0, 1.0], [2.0, 1.5], [3.0, 2.0]]), np.zeros(1), np.zeros((3, 1, 2)))


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> dict[float, tuple[StoredMap, np.ndarray]]:
    """Maps by the noise of gaps, with the true places."""
    found = {}
    for gaps in (0.05, 0.2):
        folder, made = tmp_path_factory.mktemp("map"), drive(120, noise=0.5, gaps=gaps)
        write_map(folder, find_map(made), made.segments, made.turns)
        stored = read_map(folder)
        assert stored is not None
        found[gaps] = stored, made.place
    return found


def test_errors_of_the_covariance_that_samples_estimate_have_a_normalised_error_of_one():
    rng, root = np.random.default_rng(0), np.array([[0.03, 0.0], [0.02, 0.01]])
    for samples in (8, 100):
        drawn = rng.standard_normal((20_000, samples, 2)) @ root.T
        covariance = np.einsum("nsa,nsb->nab", drawn, drawn) / samples
        wrong = rng.standard_normal((20_000, 2)) @ root.T
        assert measure_nees(covariance, samples, wrong) == pytest.approx(1.0, rel=0.05)
        assert measure_nees(covariance, samples, 2.0 * wrong) == pytest.approx(4.0, rel=0.05)


def test_a_map_is_measured_whatever_its_frame(maps):
    stored, place = maps[0.05]
    one, other = (judge_map(place_map(stored, there)) for there in (place, place @ TURN.T + [5.0, -3.0]))
    for name in ("rms_m", "median_m", "max_m", "nees"):
        assert one[name] == pytest.approx(other[name], rel=1e-6)
    assert 0.1 < one["nees"] < 3.0 and one["median_m"] <= one["rms_m"] <= one["max_m"]


def test_the_map_is_of_the_camera_and_not_of_the_axle():
    yaw = np.array([0.0, np.pi / 2, np.pi, 1.0])
    pose = np.column_stack([np.arange(4.0), np.zeros(4), yaw])
    settings = {"camera_mount": {"ahead_m": 0.05, "left_m": -0.02}}
    recording = SimpleNamespace(manifest=SimpleNamespace(settings=settings))
    place = find_true_camera(cast(Recording, recording), cast(Truth, SimpleNamespace(pose=pose)))
    np.testing.assert_allclose(place[:3], [[0.05, -0.02], [1.02, 0.05], [1.95, 0.02]], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(place - pose[:, :2], axis=1), np.hypot(0.05, 0.02))


def test_more_than_a_twentieth_makes_a_map_undecided():
    assert [is_undecided({"undecided": share}) for share in (0.0, 0.05, 0.06)] == [False, False, True]
