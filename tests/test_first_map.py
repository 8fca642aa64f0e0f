import numpy as np
import pytest
import torch

from deepgps import first_map
from deepgps.data import read_segments
from deepgps.features import fit_features
from deepgps.first_map import find_first_map
from deepgps.settings import FeatureSettings
from tests.test_pose_graph import error
from tests.toy import make_toy


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory):
    recording = make_toy(tmp_path_factory.mktemp("first_map") / "toy")
    segments = read_segments(recording)
    generator = torch.Generator().manual_seed(0)
    _, features = fit_features(recording.observation, segments, FeatureSettings(components=10), generator)
    return features, segments, np.load(recording.folder / "truth" / "pose.npy")[:, :2]


def test_the_map_is_exact_to_a_centimetre(toy):
    features, segments, place = toy
    found = find_first_map(features, segments, torch.Generator().manual_seed(0))
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_of_several_maps_the_cheapest_is_kept(toy, monkeypatch: pytest.MonkeyPatch):
    features, segments, _ = toy
    costs = iter([3.0, 1.0, 2.0, 4.0])
    made = []

    def pretend(places, segments, links):
        made.append(places)
        return places, next(costs)

    monkeypatch.setattr(first_map, "relax", pretend)
    found = find_first_map(features, segments, torch.Generator().manual_seed(0))
    assert found is made[1] and len(made) == len(first_map.NEIGHBOURS)


def test_same_generator_same_map(toy):
    features, segments, _ = toy
    first, second = (find_first_map(features, segments, torch.Generator().manual_seed(3)) for _ in range(2))
    assert np.array_equal(first, second)
