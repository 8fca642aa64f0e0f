"""The map by compass and the network on it: right before anything is trained, and never a mirror image."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings
from deepgps.config.scenario import load_scenario
from deepgps.data.encoder_noise import expect_errors
from deepgps.data.turns import measure_turns
from deepgps.initial_map.compass.compass_map import CompassMap
from deepgps.learning.training_data import prepare
from deepgps.methods.compass import choose_positions, make_compass_map
from deepgps.methods.fit import fit_method
from deepgps.terminal.progress import ignore
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.recording.format import Recording, open_recording, open_truth
from tests.helpers.toy import QUICK

SETTINGS = LearnSettings.model_validate(QUICK)


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


def error(found: np.ndarray, recording: Recording) -> np.ndarray:
    place = open_truth(recording.folder).pose[:, :2]
    known = np.isfinite(found).all(axis=1)
    return np.linalg.norm(fit_alignment(found[known], place[known], "SE2").apply(found[known]) - place[known], axis=1)


def test_the_map_by_compass_is_right_before_anything_is_trained(recording: Recording, tmp_path: Path):
    data, turns = prepare(recording, SETTINGS, 0, tmp_path), measure_turns(recording)
    data = replace(data, segments=expect_errors(recording, data.segments))
    found = make_compass_map(data, turns, seed=0)
    assert np.sqrt((error(found.places, recording) ** 2).mean()) < 0.05
    again = make_compass_map(data, measure_turns(recording), seed=0)
    np.testing.assert_array_equal(again.places, found.places)


def test_undecided_positions_are_learned_only_where_no_other_is_known():
    places, undecided = np.zeros((5, 2)), np.array([False, True, True, False, False])
    places[0] = np.nan
    found = SimpleNamespace(places=places, undecided=undecided)
    assert choose_positions(cast(CompassMap, found)).tolist() == [3, 4]
    found.undecided = np.ones(5, bool)
    assert choose_positions(cast(CompassMap, found)).tolist() == [1, 2, 3, 4]


def test_the_trained_map_is_not_mirrored(recording: Recording, tmp_path: Path):
    positioner = fit_method("deepgps_compass", recording, SETTINGS, 0, tmp_path / "deepgps_compass", ignore)
    assert np.median(error(positioner(recording.observation), recording)) < 0.05


def test_it_needs_turn_images_and_says_so_before_anything_is_driven():
    with pytest.raises(InputError, match=r"methods: deepgps_compass needs drive\.turn_images true"):
        load_scenario("tiny", {"methods": ["deepgps_compass"], "drive.turn_images": False})
    with pytest.raises(InputError, match="methods: deepgps_compass needs images, which world room"):
        load_scenario("landmarks", {"methods": ["deepgps_compass"]})


def test_a_leaning_camera_s_images_are_upright_for_all_that_looks_at_them(recording: Recording, tmp_path: Path):
    upright = measure_turns(recording).upright
    assert upright is not None
    upright = replace(upright, lean=(np.radians(2.0), 0.0))
    data = prepare(recording, SETTINGS, 0, tmp_path, upright)
    np.testing.assert_array_equal(data.observation, upright(recording.observation))
    assert not np.array_equal(data.observation, recording.observation)
