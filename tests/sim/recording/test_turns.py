"""Turns between segments: what is stored of them, that nothing else changes, and what lost readings leave of them."""

from pathlib import Path

import numpy as np
import pytest

from sim.planar.drive import collect as collect_plane
from sim.planar.worlds import LidarWorld
from sim.recording.collect import collect
from sim.recording.derive import choose_drive, derive
from sim.recording.format import check_recording, open_recording, open_truth, read_manifest
from sim.recording.turns import KINDS, NO_IMAGE, cut_turns, from_array, list_turns, lose_turns
from sim.settings import DriveSettings, GridSettings, LidarSettings, SimSettings
from tests.conftest import SMALL_WORLD
from tests.helpers.recordings import change, quiet, small_chunks

MAP = SimSettings(
    world="obstacles",
    lidar=LidarSettings(headings=8, rays=40, noise_m=0.01),
    drive=DriveSettings(samples=400),
    grid=GridSettings(spacing_m=0.5, headings=2),
)
EXACT_MAP = change(MAP, lidar={"noise_m": 0.0})


@pytest.mark.parametrize(
    "settings",
    [
        MAP,
        pytest.param(
            change(SMALL_WORLD, drive={"samples": 120}, image_faults={"read_noise": 0.1}), marks=pytest.mark.slow
        ),
    ],
    ids=["obstacles", "room"],
)
def test_all_other_files_are_the_same_with_and_without_turn_images(settings: SimSettings, tmp_path: Path):
    sums = []
    for taken in (True, False):
        folder, driven = tmp_path / str(taken), change(settings, drive={"turn_images": taken})
        with small_chunks():
            (collect if settings.world == "room" else collect_plane)(driven, 3, folder, quiet)
        sums.append(dict(read_manifest(folder).sha256))
    new = {"turns.npy", next(name for name in sums[0] if name.endswith("_turn.npy"))}
    assert {name: sums[0].pop(name) for name in new} and sums[0] == sums[1]


def test_turn_images_show_the_place_of_the_turn_under_the_next_segment_s_heading(tmp_path: Path):
    collect_plane(EXACT_MAP, 0, tmp_path, quiet)
    recording, truth = open_recording(tmp_path), open_truth(tmp_path)
    turns = recording.turns
    assert turns is not None and recording.turn_observation is not None
    segments = recording.manifest.segments or 0
    assert len(turns.before) == segments - 1
    world = LidarWorld(MAP, 0)
    observation = recording.reading[turns.after, 1]
    for before, image, first in zip(turns.before, turns.image, observation, strict=True):
        if image == NO_IMAGE:  # relocated: the observation of the first reading after it is another one
            assert first == before + 1
            continue
        assert first == before
        pose = np.array([*truth.pose[before, :2], truth.pose[min(first + 1, len(truth.pose) - 1), 2]])
        if first + 1 < len(truth.pose):
            np.testing.assert_allclose(recording.turn_observation[image], world.observe(pose), atol=1e-5)
    relocated = turns.kind == KINDS.index("relocated")
    np.testing.assert_array_equal(turns.image == NO_IMAGE, relocated)
    assert relocated.sum() == (segments - 1) // world.relocate_after


@pytest.mark.slow
def test_a_turn_image_in_a_room_is_the_observation_before_shifted_by_the_angle_of_the_wheels(small_recording: Path):
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    turns = recording.turns
    assert turns is not None and recording.turn_observation is not None
    sectors, odometry = recording.observation.shape[2], recording.manifest.odometry
    taken = np.flatnonzero(turns.image != NO_IMAGE)
    gap = np.diff(truth.wheel_angle, axis=0)[turns.after[taken] - 1]
    turned = (gap[:, 1] - gap[:, 0]) * odometry["wheel_radius_m"] / odometry["track_m"]
    apart, as_shifted = [], []
    for turn, angle in zip(taken, turned, strict=True):
        one, other = recording.observation[turns.before[turn]], recording.turn_observation[turns.image[turn]]
        shifted = np.roll(one.astype(float), -round(angle / (2 * np.pi) * sectors), axis=1)
        apart.append(np.abs(one - other.astype(float)).mean())
        as_shifted.append(np.abs(shifted - other).mean())
    assert len(taken) > 10 and np.median(as_shifted) < 0.3 * np.median(apart)


@pytest.mark.parametrize("seed", range(5))
def test_lost_readings_leave_the_turns_between_segments_of_which_a_reading_arrives(seed: int):
    rng = np.random.default_rng(seed)
    segment = np.repeat(np.arange(40), rng.integers(2, 5, 40))
    kinds = rng.integers(0, 3, 40)
    observation = np.arange(len(segment)) - np.cumsum(np.append(0, np.diff(segment)) * (kinds[segment] == 0))
    turns = list_turns(segment, observation, kinds)
    assert len(turns.before) == 39
    np.testing.assert_array_equal(turns.image[turns.image >= 0], np.arange((kinds[1:] == 0).sum()))
    arrived = rng.random(len(segment)) < 0.4
    left = lose_turns(turns, segment, arrived)
    numbers = segment[arrived]
    expected = [number for number in range(1, 40) if number in numbers[1:] and number != numbers[0]]
    assert numbers[left.after].tolist() == expected
    assert [int(np.flatnonzero(numbers == number)[0]) for number in expected] == left.after.tolist()
    np.testing.assert_array_equal(left.image, turns.image[np.array(expected) - 1])
    np.testing.assert_array_equal(from_array(left.array).array, left.array)
    assert cut_turns(turns, 0).array.shape == (0, 4)


@pytest.mark.parametrize("samples", [100, 400])
def test_deriving_carries_the_turns(samples: int, tmp_path: Path):
    settings = change(EXACT_MAP, drive={"samples": samples}, encoder={"dropout": 0.6, "slip_per_m": 0.01})
    collect_plane(choose_drive(settings, 400), 0, tmp_path / "base", quiet)
    collect_plane(settings, 0, tmp_path / "collected", quiet)
    derive(tmp_path / "base", settings, 0, tmp_path / "derived")
    assert read_manifest(tmp_path / "derived").sha256 == read_manifest(tmp_path / "collected").sha256
    check_recording(tmp_path / "derived")
    turns = open_recording(tmp_path / "derived").turns
    assert turns is not None and 0 < len(turns.before) < (read_manifest(tmp_path / "base").segments or 0)
