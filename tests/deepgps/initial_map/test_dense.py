import numpy as np
import pytest
import torch

from deepgps.data.features import fit_features
from deepgps.data.segments import read_segments
from deepgps.initial_map import dense
from deepgps.initial_map.dense import adopt_regions, find_initial_map, find_regions, lay_over
from deepgps.initial_map.isomap import find_loop_closures
from deepgps.initial_map.pose_graph import relax
from deepgps.settings import FeatureSettings
from tests.deepgps.initial_map.test_pose_graph import error
from tests.helpers.toy import make_toy


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory):
    recording = make_toy(tmp_path_factory.mktemp("first_map") / "toy")
    segments = read_segments(recording)
    generator = torch.Generator().manual_seed(0)
    _, features = fit_features(recording.observation, segments, FeatureSettings(components=10), generator)
    return features, segments, np.load(recording.folder / "truth" / "pose.npy")[:, :2]


def test_the_map_is_exact_to_a_centimetre(toy):
    features, segments, place = toy
    found = find_initial_map(features, segments, torch.Generator().manual_seed(0))
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_of_several_maps_the_cheapest_is_kept(toy, monkeypatch: pytest.MonkeyPatch):
    features, segments, _ = toy
    costs = iter([3.0, 1.0, 2.0, 4.0])
    made = []

    def pretend(places, segments, closures):
        made.append(places)
        return places, next(costs)

    monkeypatch.setattr(dense, "relax", pretend)
    monkeypatch.setattr(dense, "adopt_regions", lambda places, cost, *_: (places, cost))
    monkeypatch.setattr(dense, "find_weak_parts", lambda *_: [])
    found = find_initial_map(features, segments, torch.Generator().manual_seed(0))
    assert found is made[1] and len(made) == len(dense.NEIGHBOURS)


def test_weakly_connected_parts_are_mirrored_last(toy, monkeypatch: pytest.MonkeyPatch):
    features, segments, _ = toy
    monkeypatch.setattr(dense, "mirror_parts", lambda places, *_: places + 1.0)
    mirrored = find_initial_map(features, segments, torch.Generator().manual_seed(0))
    monkeypatch.setattr(dense, "mirror_parts", lambda places, *_: places)
    assert np.array_equal(mirrored, find_initial_map(features, segments, torch.Generator().manual_seed(0)) + 1.0)


def mirror_corner(place: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Mirror the observations in a corner about the line that cuts it off."""
    bent = place.copy()
    out = (place - corner) @ [0.6, 0.8]
    inside = out > 0.0
    bent[inside] -= 2.0 * out[inside, None] * np.array([0.6, 0.8])
    return bent


def test_a_mirrored_region_is_replaced_from_another_map_in_any_frame(toy):
    features, segments, place = toy
    closures = find_loop_closures(features, segments, (3,))[0]
    bent = mirror_corner(place, np.quantile(place, 0.8, axis=0))
    wrong = np.linalg.norm(bent - place, axis=1) > 0.05
    other = place[:, ::-1] @ np.array([[0.6, -0.8], [0.8, 0.6]]) + [4.0, -1.0]
    laid = lay_over(other, bent)
    assert 10 < wrong.sum() < len(place) / 4
    assert np.linalg.norm(laid - place, axis=1).max() < 1e-6
    regions = find_regions(bent, laid, segments, closures)
    assert np.mean(wrong[np.concatenate(regions)]) == 1.0 and len(np.concatenate(regions)) > 0.5 * wrong.sum()
    _, dear = relax(bent, segments, closures, 2.0)
    found, cost = adopt_regions(bent, dear, other, segments, closures)
    assert cost <= dear
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_nothing_is_taken_from_an_equal_map_nor_from_a_worse_one(toy):
    features, segments, place = toy
    closures = find_loop_closures(features, segments, (3,))[0]
    right, cost = relax(place, segments, closures)
    assert not find_regions(right, lay_over(right, right), segments, closures)
    kept, same = adopt_regions(right, cost, mirror_corner(place, np.quantile(place, 0.8, axis=0)), segments, closures)
    assert same <= cost and np.sqrt(np.mean(error(kept, place) ** 2)) < 0.01


def test_same_generator_same_map(toy):
    features, segments, _ = toy
    first, second = (find_initial_map(features, segments, torch.Generator().manual_seed(3)) for _ in range(2))
    assert np.array_equal(first, second)
