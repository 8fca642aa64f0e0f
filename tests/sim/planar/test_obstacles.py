"""The lidar maps: scans are geometry, the drive keeps clear of obstacles, and its recording is one as any other."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.data.segments import read_segments
from sim.errors import InputError
from sim.planar.drive import collect
from sim.planar.worlds import MIN_PASSAGE, LidarWorld, place_obstacles
from sim.recording.format import Truth, check_recording, open_recording, open_truth
from sim.settings import DriveSettings, GridSettings, LidarSettings, ObstaclesSettings, SimSettings
from tests.helpers.recordings import quiet

SETTINGS = SimSettings(
    world="obstacles",
    lidar=LidarSettings(rays=64, headings=4),
    drive=DriveSettings(spacing_m=0.04, samples=600),
    grid=GridSettings(spacing_m=0.2, headings=3),
)
WORLD = LidarWorld(SETTINGS, 3)


def edges_of(world: LidarWorld) -> np.ndarray:
    """Every edge of obstacles and walls as two ends (n, 2, 2)."""
    corner = [(0, 0), (1, 0), (1, 1), (0, 1)]
    boxes = [*world.box, world.bounds]
    points = [[(box[i, 0], box[j, 1]) for i, j in corner] for box in boxes]
    return np.array([[points[b][k], points[b][(k + 1) % 4]] for b in range(len(boxes)) for k in range(4)])


def meet_edges(edges: np.ndarray, place: np.ndarray, angle: float) -> float:
    """Distance along a ray to the nearest edge, each solved as two equations: place + t u = a + s (b - a)."""
    u = np.array([np.cos(angle), np.sin(angle)])
    nearest = np.inf
    for a, b in edges:
        matrix = np.stack([u, a - b], axis=1)
        if abs(np.linalg.det(matrix)) > 1e-12:
            t, s = np.linalg.solve(matrix, a - place)
            if t >= 0 and -1e-12 <= s <= 1 + 1e-12:
                nearest = min(nearest, t)
    return nearest


def free_poses(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = rng.uniform([-1, -1, -np.pi], [1, 1, np.pi], (20 * count, 3))
    return poses[WORLD.is_free(poses[:, :2])][:count]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lidar") / "recording"
    collect(SETTINGS, 3, folder, quiet)
    return folder


@pytest.fixture(scope="module")
def truth(folder: Path) -> Truth:
    return open_truth(folder)


def test_scans_are_the_distances_to_the_nearest_edges():
    edges = edges_of(WORLD)
    for pose, scan in zip(poses := free_poses(5, 0), WORLD.observe(poses), strict=True):
        for heading, ray in [(0, 0), (0, 16), (1, 5), (2, 33), (3, 63)]:
            angle = pose[2] + 2 * np.pi * (ray + heading / 4) / 64
            assert scan[heading, ray] == pytest.approx(meet_edges(edges, pose[:2], angle), abs=1e-6)


@given(quarter=st.integers(0, 3), seed=st.integers(0, 50))
@settings(max_examples=25, deadline=None)
def test_rays_along_the_walls_are_like_their_neighbours(quarter: int, seed: int):
    pose = free_poses(1, seed)[0]
    pose[2] = quarter * np.pi / 2
    np.testing.assert_allclose(WORLD.observe(pose), WORLD.observe(pose + [0, 0, 1e-7]), atol=1e-5)


@given(turn=st.integers(-300, 300), seed=st.integers(0, 50))
@settings(max_examples=25, deadline=None)
def test_turning_shifts_the_rays_in_a_circle(turn: int, seed: int):
    pose = free_poses(1, seed)[0]
    turned = WORLD.observe(pose + [0, 0, 2 * np.pi * turn / 256]).T.ravel()
    # An obstacle's corner may be hit by one of two equal rays and missed by the other, by a rounding error.
    assert (np.abs(turned - np.roll(WORLD.observe(pose).T.ravel(), -turn)) < 1e-4).mean() > 0.99


def test_obstacles_leave_passages_and_one_seed_gives_one_map():
    box = place_obstacles(20, np.random.default_rng(1))
    gap = np.maximum(box[:, None, 0] - box[None, :, 1], box[None, :, 0] - box[:, None, 1]).max(axis=-1)
    assert len(box) == 20
    assert ((gap <= 0) | (gap >= MIN_PASSAGE)).all()
    placed = SETTINGS.model_copy(update={"obstacles": ObstaclesSettings(seed=3)})
    assert np.array_equal(LidarWorld(placed, 9).box, WORLD.box)
    assert not np.array_equal(LidarWorld(SETTINGS, 9).box, WORLD.box)


def test_the_drive_keeps_clear_of_obstacles_and_segments_are_straight(truth: Truth):
    assert WORLD.is_free(truth.pose[:, :2] * (1 - 1e-9)).mean() > 0.99  # places at the very rim may round either way
    assert len(truth.pose) == 600
    lengths = []
    for number in np.unique(truth.reading[:, 0]):
        points = truth.pose[truth.reading[truth.reading[:, 0] == number, 1], :2]
        step = np.diff(points, axis=0)
        assert np.allclose(step, step[0], atol=1e-9)
        assert np.linalg.norm(step[0]) == pytest.approx(0.04)
        lengths.append(len(step))
    assert min(lengths[:-1]) >= 3


def test_the_robot_is_relocated_and_nothing_tells_it_where(folder: Path, truth: Truth):
    segment, observation = truth.reading.T
    turns = np.flatnonzero(np.diff(segment))
    shared = observation[turns] == observation[turns + 1]
    assert np.array_equal(np.flatnonzero(~shared), np.arange(9, len(turns), 10))
    segments = read_segments(open_recording(folder))
    for row, count in enumerate(segments.count.tolist()):
        points = truth.pose[segments.index[row, :count].numpy(), :2]
        assert np.allclose(np.linalg.norm(points - points[0], axis=1), segments.distance[row, :count], atol=2e-4)


def test_the_recording_is_whole_and_observes_what_the_world_shows(folder: Path, truth: Truth):
    check_recording(folder)
    recording = open_recording(folder)
    assert np.array_equal(recording.observation, WORLD.observe(truth.pose))
    assert np.array_equal(recording.test_observation, WORLD.observe(truth.test_pose))
    assert recording.observation.shape == (600, 4, 64)
    assert recording.observation.dtype == np.float32
    assert truth.free_space.is_reachable(truth.test_pose[..., :2]).all()


def test_same_seed_same_bytes(folder: Path, tmp_path: Path):
    collect(SETTINGS, 3, tmp_path / "again", quiet)
    assert open_recording(tmp_path / "again").manifest.sha256 == open_recording(folder).manifest.sha256


def test_noise_is_that_of_the_settings(folder: Path, tmp_path: Path):
    noisy = SETTINGS.model_copy(update={"lidar": LidarSettings(rays=64, headings=4, noise_m=0.01)})
    collect(noisy, 3, tmp_path / "noisy", quiet)
    exact, seen = open_recording(folder).observation, open_recording(tmp_path / "noisy").observation
    near = exact > 0.1
    assert np.std((seen - exact)[near]) == pytest.approx(0.01, rel=0.05)


def test_spacings_that_are_too_large_are_one_clear_line(tmp_path: Path):
    sparse = SETTINGS.model_copy(update={"grid": GridSettings.model_construct(spacing_m=3.0, headings=1)})
    with pytest.raises(InputError, match=r"grid.spacing_m 3.0 m leaves no test position"):
        collect(sparse, 0, tmp_path / "sparse", quiet)
    with pytest.raises(ValueError, match=r"drive.spacing_m 0.5 m must be at most a quarter .* obstacles world, 1.96 m"):
        SimSettings(world="obstacles", drive=DriveSettings(spacing_m=0.5))
