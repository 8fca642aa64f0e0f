"""Turns by the wheels: left is left, and a path that has drifted still starts a right map."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings
from deepgps.data.features import normalise
from deepgps.data.segments import read_segments
from deepgps.initial_map.distances.dense import find_chirality, read_turns, straighten
from deepgps.methods.fit import fit_method
from sim.alignment import fit_alignment
from sim.recording.format import Recording, open_truth
from sim.sensors.encoder import slip_wheels
from tests.helpers.toy import M_PER_TICK, ODOMETRY, QUICK, make_toy

SETTINGS = LearnSettings.model_validate(QUICK)


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make_toy(tmp_path_factory.mktemp("turns") / "toy")


def slip(recording: Recording, slip_per_m: float) -> Recording:
    """The same drive with encoders that slip."""
    per_tick = M_PER_TICK / ODOMETRY["wheel_radius_m"]
    angle = slip_wheels(
        recording.reading[:, 2:] * per_tick, slip_per_m, ODOMETRY["wheel_radius_m"], np.random.default_rng(0)
    )
    ticks = np.rint(angle / per_tick).astype(np.int64)
    return replace(recording, reading=np.column_stack([recording.reading[:, :2], ticks]))


def error(positions: np.ndarray, truth: np.ndarray, kind) -> float:
    known = np.isfinite(positions).all(axis=1)
    aligned = fit_alignment(positions[known], truth[known], kind).apply(positions[known])
    return float(np.sqrt(np.mean(((aligned - truth[known]) ** 2).sum(axis=1))))


def test_the_path_of_exact_wheels_is_the_truth(toy: Recording):
    place = open_truth(toy.folder).pose[:, :2]
    assert error(read_turns(toy).path, place, "SE2") < 0.01


@pytest.mark.parametrize("slip_per_m", [0.0, 0.01, 0.05])
def test_a_mirrored_map_is_told_by_its_turns_even_where_the_path_is_lost(toy: Recording, slip_per_m: float):
    recording, place = slip(toy, slip_per_m), open_truth(toy.folder).pose[:, :2]
    turns, segments = read_turns(recording), read_segments(recording)
    for angle in (0.0, 1.0, -2.5):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        assert find_chirality(place @ turn.T + 3.0, segments, turns.angle) == 1
        assert find_chirality(place @ turn.T * [1.0, -1.0], segments, turns.angle) == -1


def test_a_path_that_drifts_is_straightened_by_what_looks_alike(toy: Recording):
    recording, place = slip(toy, 0.004), open_truth(toy.folder).pose[:, :2]
    turns, segments = read_turns(recording), read_segments(recording)
    features = normalise(recording.observation)[1]
    found = straighten(turns, features, segments, np.random.default_rng(0)).places
    drift = error(turns.path, place, "SE2")
    assert drift > 0.25
    assert error(found, place, "SE2") < drift / 4


def test_learning_with_turns_gives_a_map_that_is_not_mirrored(toy: Recording, tmp_path: Path):
    place = open_truth(toy.folder).pose[:, :2]
    steps = SETTINGS.train.model_copy(update={"steps": 100})
    settings = SETTINGS.model_copy(update={"train": steps})
    learned = fit_method("deepgps_with_turns", toy, settings, 0, tmp_path / "turns")(toy.observation)
    assert error(learned, place, "SE2") < 0.1


@pytest.mark.slow
def test_a_drive_with_left_and_right_exchanged_is_learned_mirrored_with_turns_alone(toy: Recording, tmp_path: Path):
    place = open_truth(toy.folder).pose[:, :2]
    swapped = replace(toy, reading=toy.reading[:, [0, 1, 3, 2]])
    mirrored = fit_method("deepgps_with_turns", swapped, SETTINGS, 0, tmp_path / "swapped")(toy.observation)
    assert error(mirrored * [1.0, -1.0], place, "SE2") < 0.06 < error(mirrored, place, "SE2")
    alone = [
        fit_method("deepgps", one, SETTINGS, 0, tmp_path / f"alone{n}")(toy.observation)
        for n, one in enumerate((toy, swapped))
    ]
    np.testing.assert_array_equal(alone[0], alone[1])
