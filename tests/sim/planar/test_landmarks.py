"""The landmarks world: what is seen is geometry, the drive is straight, and its recording is one as any other."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from deepgps.data.segments import dead_reckon, read_segments
from sim.alignment import fit_alignment
from sim.errors import WorkError
from sim.planar.drive import choose_heading, collect, drive_segments
from sim.planar.worlds import LandmarkWorld
from sim.recording.format import Recording, Truth, check_recording, open_recording, open_truth
from sim.rng import stream
from sim.settings import (
    MAX_GRID_DISTANCES,
    DriveSettings,
    EncoderSettings,
    GridSettings,
    LandmarksSettings,
    SimSettings,
)
from tests.helpers.recordings import quiet

SETTINGS = SimSettings(
    world="landmarks",
    landmarks=LandmarksSettings(count=20, reach_m=0.6, segments=30),
    encoder=EncoderSettings(ticks_per_rev=65536),
    drive=DriveSettings(spacing_m=0.05),
    grid=GridSettings(spacing_m=0.25, headings=2),
)
TICK_M = 2 * np.pi * 0.033 / 65536


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("landmarks") / "recording"
    collect(SETTINGS, 3, folder, quiet)
    return folder


@pytest.fixture(scope="module")
def recording(folder: Path) -> Recording:
    return open_recording(folder)


@pytest.fixture(scope="module")
def truth(folder: Path) -> Truth:
    return open_truth(folder)


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), yaw=st.floats(-7, 7))
def test_heading_does_not_matter_and_nothing_is_seen_beyond_the_reach(x: float, y: float, yaw: float):
    world = LandmarkWorld(SETTINGS, 0)
    seen = world.observe(np.array([x, y, yaw]))
    assert np.array_equal(seen, world.observe(np.array([x, y, 0.0])))
    away = np.hypot(world.landmark[:, 0] - x, world.landmark[:, 1] - y)
    assert np.allclose(seen, np.where(away < 0.6, away, 0.6), atol=1e-6)
    assert seen.dtype == np.float32


def test_the_whole_square_is_free_and_nothing_else():
    world = LandmarkWorld(SETTINGS, 0)
    corners = world.bounds[[0, 0, 1, 1], [0, 1, 0, 1]].reshape(-1, 1) * np.ones(2)
    assert world.is_free(corners).all()
    assert not world.is_free(np.array([[1.001, 0.0], [0.0, -1.001]])).any()
    space = world.space
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (500, 2))
    clear = np.abs(np.abs(points).max(axis=1) - 1.0) > 0.02
    assert np.array_equal(space.is_reachable(points)[clear], world.is_free(points)[clear])


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), yaw=st.floats(-7, 7))
def test_the_way_ahead_ends_at_a_wall(x: float, y: float, yaw: float):
    way = LandmarkWorld(SETTINGS, 0).way_ahead(np.array([x, y]), yaw)
    end = np.array([x + way * np.cos(yaw), y + way * np.sin(yaw)])
    assert way >= 0.0
    assert np.abs(end).max() == pytest.approx(1.0, abs=1e-6)


def test_segments_are_straight_sampled_evenly_and_driven_from_wall_to_wall(truth: Truth, recording: Recording):
    assert len(np.unique(truth.reading[:, 0])) == 30
    assert np.abs(truth.pose[:, :2]).max() <= 1.0 + 1e-9
    for number in range(30):
        points = truth.pose[truth.reading[truth.reading[:, 0] == number, 1], :2]
        step = np.diff(points, axis=0)
        assert np.allclose(step, step[0], atol=1e-9)
        assert np.linalg.norm(step[0]) == pytest.approx(0.05)
        assert np.abs(points[-1]).max() > 1.0 - 0.05


def test_a_turning_place_is_one_observation_with_two_readings(truth: Truth):
    segment, observation = truth.reading.T
    turns = np.flatnonzero(np.diff(segment))
    assert len(turns) == 29
    assert np.array_equal(observation[turns], observation[turns + 1])
    assert np.array_equal(np.unique(observation), np.arange(len(truth.pose)))


def test_encoder_distances_are_the_true_ones(recording: Recording, truth: Truth):
    segments = read_segments(recording)
    for row, count in enumerate(segments.count.tolist()):
        points = truth.pose[segments.index[row, :count].numpy(), :2]
        way = np.linalg.norm(points - points[0], axis=1)
        assert np.abs(segments.distance[row, :count].numpy() - way).max() < 2 * TICK_M + 1e-6


def test_dead_reckoning_follows_the_drive(recording: Recording, truth: Truth):
    path = dead_reckon(recording)
    driven = truth.pose[recording.reading[:, 1]]
    laid = fit_alignment(path[:, :2], driven[:, :2], "SE2").apply(path[:, :2])
    assert np.abs(laid - driven[:, :2]).max() < 0.01


def test_the_recording_is_whole_and_observes_what_the_world_shows(folder: Path, recording: Recording, truth: Truth):
    check_recording(folder)
    world = LandmarkWorld(SETTINGS, 3)
    assert np.array_equal(recording.observation, world.observe(truth.pose))
    assert np.array_equal(recording.test_observation, world.observe(truth.test_pose))
    assert recording.test_observation.shape == (81, 2, 20)
    assert (np.diff(recording.time) >= 0).all()
    assert recording.manifest.samples == len(truth.pose)


def test_same_seed_same_bytes_another_seed_other_landmarks(folder: Path, recording: Recording, tmp_path: Path):
    collect(SETTINGS, 3, tmp_path / "again", quiet)
    again = open_recording(tmp_path / "again")
    assert again.manifest.sha256 == recording.manifest.sha256
    assert not np.array_equal(LandmarkWorld(SETTINGS, 9).landmark, LandmarkWorld(SETTINGS, 3).landmark)


def test_what_a_killed_collection_left_is_replaced(tmp_path: Path, recording: Recording):
    (tmp_path / "half" / "truth").mkdir(parents=True)
    (tmp_path / "half" / "reading.npy").write_bytes(b"half")
    collect(SETTINGS, 3, tmp_path / "half", quiet)
    assert np.array_equal(open_recording(tmp_path / "half").reading, recording.reading)


def test_samples_may_end_the_drive_before_its_segments():
    few = SETTINGS.model_copy(update={"drive": DriveSettings(spacing_m=0.05, samples=100)})
    drive = drive_segments(LandmarkWorld(few, 0), few, stream(0, "drive"), quiet)
    assert len(drive.pose) == 100 == drive.reading[:, 1].max() + 1
    assert len(drive.reading) == len(drive.wheel_angle) == len(drive.time)
    assert drive.reading[-1, 0] < 29


def test_where_no_heading_leads_far_enough_the_drive_ends_with_one_clear_line():
    wide = SETTINGS.model_copy(update={"drive": DriveSettings(spacing_m=0.5)})
    world, rng = LandmarkWorld(wide, 0), np.random.default_rng(0)
    with pytest.raises(WorkError, match=r"drive\.spacing_m 0\.5 m must be smaller: from \(0\.00, 0\.00\) m"):
        choose_heading(world, np.zeros(2), 0.5, 5.0, rng)  # to a corner, which is farthest, it is 1.41 m
    heading, steps = choose_heading(world, world.bounds[1], 0.5, 5.0, rng)
    assert steps >= 3 and np.cos(heading) + np.sin(heading) < 0


def test_the_drive_tells_how_far_it_is_whether_segments_or_samples_end_it():
    for samples in (100, 5000):
        told, some = list[int](), SETTINGS.model_copy(update={"drive": DriveSettings(spacing_m=0.05, samples=samples)})
        drive_segments(
            LandmarkWorld(some, 0), some, stream(0, "drive"), lambda _, done, total, told=told: told.append(done)
        )
        assert told == sorted(told) and told[0] < samples / 2 and told[-1] == samples


def test_the_grid_reaches_the_walls_and_has_the_papers_128_positions_a_side():
    grid = LandmarkWorld(SETTINGS, 0).lay_grid(GridSettings(spacing_m=0.015748, headings=1))
    assert grid.shape == (128 * 128, 1, 3)
    assert (grid[..., :2].min(), grid[..., :2].max()) == (-1.0, 1.0)
    assert len(LandmarkWorld(SETTINGS, 0).lay_grid(GridSettings(spacing_m=1.0, headings=1))) == 9


def test_a_test_grid_beyond_the_memory_is_refused_with_the_spacing_that_is_allowed():
    dense = {"world": "landmarks", "landmarks": {"count": 4096}, "grid": {"spacing_m": 0.005}}
    for changes in ({}, {"world": "obstacles", "lidar": {"rays": 4096}}):
        with pytest.raises(
            ValidationError, match=r"grid.spacing_m 0.005 m must be at least .* m in a square"
        ) as refused:
            SimSettings.model_validate(dense | changes)
        least_m = float(str(refused.value).partition("at least ")[2].split()[0])
        SimSettings.model_validate(dense | changes | {"grid": {"spacing_m": least_m}})
        if not changes:
            positions = LandmarkWorld(SETTINGS, 0).lay_grid(GridSettings(spacing_m=least_m)).size / 3
            assert 0.9 < positions * 4096 / MAX_GRID_DISTANCES <= 1.0
