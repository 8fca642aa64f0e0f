"""Laws of registration, on a real recording of a small room whose map is the truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from deepgps.config.learning import FeatureSettings, LearnSettings
from deepgps.data.segments import find_owners
from deepgps.learning.training_data import TrainingData, prepare
from deepgps.methods import appearance
from deepgps.methods.appearance import learn
from deepgps.methods.registration import find_headings
from deepgps.positioner.kriging import Kernel, krige
from deepgps.positioner.pixels import find_yaw, grey, turn
from deepgps.positioner.pose import find_poses
from deepgps.positioner.positioner import RegistrationPositioner
from deepgps.positioner.registration import MAX_INFLATION, Registration, fuse, inflate
from deepgps.positioner.stored_positioner import load_positioner, save_positioner
from sim.alignment import Alignment
from sim.geometry import wrap
from sim.recording.format import open_recording, open_truth
from tests.helpers.toy import make_toy

SETTINGS = LearnSettings(features=FeatureSettings(principal=128, components=48))


@pytest.fixture(scope="module")
def data(small_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> TrainingData:
    return prepare(open_recording(small_recording), SETTINGS, 0, tmp_path_factory.mktemp("features"))


@pytest.fixture(scope="module")
def pose(small_recording: Path) -> np.ndarray:
    return open_truth(small_recording).pose


@pytest.fixture(scope="module")
def tests(small_recording: Path) -> tuple[np.ndarray, np.ndarray]:
    """Test images (B, ...) and their true poses (B, 3)."""
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    images = recording.test_observation
    return images.reshape(-1, *images.shape[2:]), truth.test_pose.reshape(-1, 3)


@pytest.fixture(scope="module")
def positioner(data: TrainingData, pose: np.ndarray) -> RegistrationPositioner:
    return place(data, pose[:, :2], pose[:, 2])


@pytest.fixture(scope="module")
def known(positioner: RegistrationPositioner) -> Registration:
    return positioner.known


def place(data: TrainingData, places: np.ndarray, heading: np.ndarray) -> RegistrationPositioner:
    appearance, index = learn(data, places, heading)
    return RegistrationPositioner(index, appearance=appearance)


def copy(positioner: RegistrationPositioner, known: Registration) -> RegistrationPositioner:
    """The positioner with other training images."""
    assert positioner.appearance is not None
    return replace(positioner, appearance=replace(positioner.appearance, registration=known))


def draw(seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 1.0, (count, 2))
    index = np.stack([rng.permutation(count)[:12] for _ in range(5)])
    return rng.uniform(0.2, 0.8, (5, 2)), places, index


def test_weights_add_up_to_one_and_follow_a_rigid_motion() -> None:
    position, places, index = draw(0)
    one = krige(position, places, index, Kernel(0.3, 0.02))
    np.testing.assert_allclose(one.both[:, 0].sum(axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(one.both[:, 1:].sum(axis=2), 0.0, atol=1e-4)
    turned = Alignment(np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([3.0, -1.0]), 1.0)
    other = krige(turned.apply(position), turned.apply(places), index, Kernel(0.3, 0.02))
    np.testing.assert_allclose(other.both[:, 0], one.both[:, 0], atol=1e-6)
    np.testing.assert_allclose(other.variance, one.variance, atol=1e-9)


def test_gradient_agrees_with_finite_differences() -> None:
    position, places, index = draw(1)
    kernel, step = Kernel(0.3, 0.02), 1e-4
    found = krige(position, places, index, kernel).both[:, 1:]
    for axis in range(2):
        move = step * np.eye(2)[axis]
        ahead, behind = (krige(position + sign * move, places, index, kernel).both[:, 0] for sign in (1, -1))
        difference = (ahead.astype(float) - behind) / (2.0 * step)
        np.testing.assert_allclose(found[:, axis], difference, atol=2e-2 * np.abs(difference).max())


def test_without_noise_a_place_predicts_itself_for_certain() -> None:
    _, places, _ = draw(2)
    index = np.arange(12)[None].repeat(3, axis=0)
    found = krige(places[:3], places, index, Kernel(0.3, 1e-9))
    np.testing.assert_allclose(found.both[:, 0], np.eye(3, 12), atol=1e-4)
    np.testing.assert_allclose(found.variance, 0.0, atol=1e-6)


def test_far_away_nothing_is_known() -> None:
    _, places, index = draw(3)
    far = krige(np.full((5, 2), 50.0), places, index, Kernel(0.3, 0.02))
    assert (far.variance > 1.0).all()


def test_a_turned_image_is_found_by_its_angle(tests: tuple[np.ndarray, np.ndarray]) -> None:
    images, angle = grey(tests[0][:20]), np.linspace(-3.0, 3.0, 20)
    turned, change = turn(images, angle)
    np.testing.assert_allclose(wrap(find_yaw(images, turned) - angle), 0.0, atol=np.radians(1.0))
    step = 1e-2
    difference = (turn(images, angle + step)[0] - turn(images, angle - step)[0]) / (2.0 * step)
    assert np.abs(change - difference).max() < 0.05 * np.abs(change).max()
    sector = 2.0 * np.pi / images.shape[2]
    np.testing.assert_allclose(turn(images, np.full(20, sector))[0], np.roll(images, 1, axis=2), atol=1e-2)


def test_gauss_newton_ends_where_the_cost_is_least(known: Registration, pose: np.ndarray) -> None:
    features = known.known[::20]
    found = known.match(features, pose[::20, :2] + 0.03, rounds=8)
    for move in ([0.01, 0.0], [-0.01, 0.0], [0.0, 0.01], [0.0, -0.01]):
        beside = known.match(features, found.position + move, rounds=0)
        assert (beside.residual >= found.residual - 1e-3).mean() > 0.9


def test_a_training_image_is_found_where_it_is(
    positioner: RegistrationPositioner, data: TrainingData, tests: tuple[np.ndarray, np.ndarray], pose: np.ndarray
) -> None:
    images, true = tests
    error = np.linalg.norm(positioner.register(data.observation).position - pose[:, :2], axis=1)
    others = np.linalg.norm(positioner.register(images).position - true[:, :2], axis=1)
    assert np.quantile(error, 0.95) < np.median(others)


def test_it_is_ahead_of_the_nearest_image(
    positioner: RegistrationPositioner, tests: tuple[np.ndarray, np.ndarray], pose: np.ndarray
) -> None:
    images, true = tests
    found = positioner.register(images)
    error = np.linalg.norm(found.position - true[:, :2], axis=1)
    assert positioner.appearance is not None
    nearest = positioner.known.find_starts(positioner.appearance.features.apply(images).numpy())[:, 0]
    assert np.median(error) < 0.7 * np.median(np.linalg.norm(pose[nearest, :2] - true[:, :2], axis=1))
    sure = found.reason == 0
    assert np.degrees(np.median(np.abs(wrap(found.yaw - true[:, 2])[sure]))) < 1.5


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_motion_of_the_map_moves_every_answer_with_it(
    positioner: RegistrationPositioner,
    data: TrainingData,
    tests: tuple[np.ndarray, np.ndarray],
    pose: np.ndarray,
    mirror: float,
) -> None:
    cos, sin = 0.6, 0.8
    rotation = np.array([[cos, -sin * mirror], [sin, cos * mirror]])
    motion = Alignment(rotation, np.array([5.0, -2.0]), 1.0)
    moved = place(data, motion.apply(pose[:, :2]), motion.turn(pose[:, 2]))
    assert moved.mirrored == (mirror < 0.0)
    one, other = find_poses(positioner, tests[0]).align(motion), find_poses(moved, tests[0])
    np.testing.assert_allclose(other.position, one.position, atol=1e-6)
    assert one.yaw is not None and other.yaw is not None
    assert one.covariance is not None and other.covariance is not None
    assert one.reason is not None and other.reason is not None
    np.testing.assert_allclose(wrap(other.yaw - one.yaw), 0.0, atol=1e-5)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-3, atol=1e-9)
    np.testing.assert_array_equal(other.reason, one.reason)


def test_two_places_with_the_same_images_are_two_modes_of_the_same_weight(
    positioner: RegistrationPositioner, known: Registration, tests: tuple[np.ndarray, np.ndarray]
) -> None:
    away, pixels = np.array([20.0, 0.0]), known.pixels
    assert pixels is not None
    twice = replace(
        known,
        known=np.tile(known.known, (2, 1)),
        places=np.concatenate([known.places, known.places + away]),
        place_std=np.tile(known.place_std, 2),
        pixels=replace(pixels, images=np.tile(pixels.images, (2, 1, 1))),
    )
    copied = copy(positioner, twice)
    alone, found = positioner.register(tests[0]), copied.register(tests[0])
    sure = alone.weight[:, 0] > 0.999
    assert sure.mean() > 0.5
    np.testing.assert_allclose(found.weight[sure, :2], 0.5, atol=1e-3)
    np.testing.assert_allclose(np.abs(np.diff(found.mode[sure, :2, 0], axis=1)), 20.0, atol=1e-3)
    assert (found.reason[alone.reason == 0] == 2).all()


def test_the_ellipse_grows_with_the_noise(
    positioner: RegistrationPositioner, tests: tuple[np.ndarray, np.ndarray]
) -> None:
    rng, images = np.random.default_rng(0), tests[0]
    sizes = []
    for noise in (0.0, 10.0, 30.0):
        noisy = np.rint(images + rng.normal(0.0, noise, images.shape)).clip(0, 255).astype(np.uint8)
        covariance = positioner.register(noisy).covariance
        sizes.append(np.median(np.trace(covariance, axis1=1, axis2=2)))
    assert sizes[0] < sizes[1] < sizes[2]


def test_hidden_sectors_hardly_move_the_answer(
    positioner: RegistrationPositioner, tests: tuple[np.ndarray, np.ndarray]
) -> None:
    images, true = tests
    hidden = images.copy()
    hidden[:, :, 5:8] = 127
    seen, left = (np.linalg.norm(positioner.register(some).position - true[:, :2], axis=1) for some in (images, hidden))
    assert np.median(left) < 2.0 * np.median(seen)
    assert (positioner.register(hidden).reason == 0).mean() > 0.5


def test_an_image_of_nothing_is_refused(positioner: RegistrationPositioner) -> None:
    shape = (4, *positioner.shape)
    images = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    images[0], images[1] = 0, 255
    found = find_poses(positioner, images)
    assert np.isfinite(found.position).all()
    assert found.accepted is not None and not found.accepted.any()


def test_the_same_bytes_on_any_number_of_cores(
    positioner: RegistrationPositioner, tests: tuple[np.ndarray, np.ndarray]
) -> None:
    found = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            found.append(positioner.register(tests[0]))
    np.testing.assert_array_equal(found[0].position, found[1].position)


def test_none_and_one_by_one_as_all_at_once(
    positioner: RegistrationPositioner, tests: tuple[np.ndarray, np.ndarray]
) -> None:
    images = tests[0][:10]
    assert positioner.register(images[:0]).position.shape == (0, 2)
    single = np.concatenate([positioner.register(images[k : k + 1]).position for k in range(10)])
    np.testing.assert_allclose(single, positioner.register(images).position, atol=1e-5)


@pytest.mark.parametrize("with_headings", [True, False])
def test_stored_and_read_it_gives_the_same(
    data: TrainingData, pose: np.ndarray, tests: tuple[np.ndarray, np.ndarray], tmp_path: Path, with_headings: bool
) -> None:
    heading = pose[:, 2] if with_headings else np.full(len(pose), np.nan)
    positioner = place(data, pose[:, :2], heading)
    assert (positioner.mirrored is not None) == with_headings
    save_positioner(tmp_path, positioner, {})
    one, other = (find_poses(some, tests[0]) for some in (positioner, load_positioner(tmp_path)))
    np.testing.assert_array_equal(other.position, one.position)
    assert one.accepted is not None and one.accepted.mean() > 0.5
    assert (one.yaw is not None) == with_headings


def test_a_fused_position_is_nearer_to_the_surer() -> None:
    one, other = np.zeros((1, 2)), np.ones((1, 2))
    position, covariance = fuse(one, np.eye(2)[None], other, 3.0 * np.eye(2)[None])
    np.testing.assert_allclose(position, [[0.25, 0.25]])
    np.testing.assert_allclose(covariance, [0.75 * np.eye(2)])


def test_headings_are_the_directions_of_segments_and_unknown_where_the_robot_turns(
    small_recording: Path, pose: np.ndarray
) -> None:
    recording = open_recording(small_recording)
    heading = find_headings(recording, pose[:, :2])
    known, uses = np.isfinite(heading), np.bincount(recording.reading[:, 1], minlength=len(pose))
    assert not known[uses > 1].any() and known.mean() > 0.5
    assert np.abs(wrap(heading - pose[:, 2]))[known].max() < 0.01
    first, last = (np.diff(recording.reading[:, 0], **edge) != 0 for edge in ({"prepend": -1}, {"append": -1}))
    ends = find_headings(replace(recording, reading=recording.reading[first | last]), pose[:, :2])
    assert np.isfinite(ends[uses > 1]).mean() > 0.9
    assert np.nanmax(np.abs(wrap(ends - pose[:, 2]))) < 0.05


def test_segments_seen_with_wrong_headings_are_turned_back(
    data: TrainingData, pose: np.ndarray, tests: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    images, there = tests
    owner = find_owners(data.segments, len(pose))[0].numpy()
    turned = pose[:, 2] + np.radians(np.random.default_rng(0).uniform(-20.0, 20.0, owner.max() + 1))[owner]
    refined = place(data, pose[:, :2], turned).register(images)
    monkeypatch.setattr(appearance, "HEADING_ROUNDS", 0)
    found = refined, place(data, pose[:, :2], turned).register(images)
    off, untouched = (np.median(np.abs(wrap(one.yaw - there[:, 2]))) for one in found)
    assert off < 0.8 * untouched


def test_an_image_that_differs_more_than_usual_has_a_larger_ellipse() -> None:
    factors = inflate(np.array([0.5, 1.0, 2.0, 100.0]))
    assert factors[1] == 1.0 and (np.diff(factors) > 0.0).all() and factors[-1] == MAX_INFLATION


def test_other_positions_for_the_same_images_have_larger_ellipses_and_are_refused_where_they_are_far(
    positioner: RegistrationPositioner, tests: tuple[np.ndarray, np.ndarray]
) -> None:
    found = positioner.register(tests[0])
    away = np.tile([0.03, 0.0], (len(found.position), 1))
    near, far = found.move(found.position + away), found.move(found.position + 2.0 * away)
    np.testing.assert_allclose(near.covariance[:, 0, 0] - found.covariance[:, 0, 0], 0.03**2, rtol=1e-6)
    np.testing.assert_array_equal(near.reason, found.reason)
    assert (far.reason[found.reason == 0] == 3).all()
    np.testing.assert_array_equal(found.move(found.position).covariance, found.covariance)


def test_exact_distances_to_landmarks_tell_the_place_to_a_millimetre(tmp_path: Path) -> None:
    recording = make_toy(tmp_path / "toy")
    place, test = (
        part[..., :2] for part in (open_truth(recording.folder).pose, open_truth(recording.folder).test_pose)
    )
    exact = learn(prepare(recording, LearnSettings(), 0, tmp_path), place, np.zeros(len(place)))[0]
    found = exact.register(np.asarray(recording.test_observation)[:, 0])
    assert exact.registration.kernel.nugget < 1e-3
    assert np.median(np.linalg.norm(found.position - test[:, 0], axis=1)) < 0.001
