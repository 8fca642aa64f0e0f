import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.data.segments import Segments, read_segments
from deepgps.initial_map.distances.folding import LENGTH_ERROR_LIMIT, OVERLAP_LIMIT, FoldScore, score_folding
from tests.helpers.toy import make_toy


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory):
    recording = make_toy(tmp_path_factory.mktemp("fold") / "toy", samples=1000)
    place = np.load(recording.folder / "truth" / "pose.npy")[:, :2]
    return place, torch.tensor(recording.observation), read_segments(recording)


def signs(place: np.ndarray, toy) -> FoldScore:
    return score_folding(place, toy[1], toy[2], torch.Generator().manual_seed(0))


def fold_at(place: np.ndarray, x: float) -> np.ndarray:
    """Turn over what lies right of ``x``."""
    return np.where(place[:, :1] > x, place * [-1.0, 1.0] + [2.0 * x, 0.0], place)


def test_the_right_map_shows_no_sign(toy):
    assert signs(toy[0], toy) == FoldScore(0.0, 0.0)


def test_noise_of_a_few_centimetres_is_no_fold(toy):
    noisy = toy[0] + np.random.default_rng(0).normal(0.0, 0.02, toy[0].shape)
    assert not signs(noisy, toy).folded


@pytest.mark.parametrize("x", [-0.5, 0.0, 0.7])
def test_a_folded_map_is_found_by_both_signs(toy, x: float):
    found = signs(fold_at(toy[0], x), toy)
    assert found.length_error_fraction > LENGTH_ERROR_LIMIT
    assert found.overlap_fraction > OVERLAP_LIMIT


def test_a_fold_that_no_segment_crosses_is_still_found(toy):
    place, features, segments = toy
    right = place[:, 0] > 0
    sides = [{bool(right[i]) for i in row[:count]} for row, count in zip(segments.index, segments.count, strict=True)]
    keep = torch.tensor([len(side) == 1 for side in sides])
    apart = Segments(segments.index[keep], segments.distance[keep], segments.count[keep], 0)
    found = score_folding(fold_at(place, 0.0), features, apart, torch.Generator().manual_seed(0))
    assert found.length_error_fraction == 0.0
    assert found.overlap_fraction > OVERLAP_LIMIT


@given(angle=st.floats(-4, 4), x=st.floats(-20, 20), mirrored=st.booleans())
@settings(max_examples=5, deadline=None)
def test_signs_do_not_see_rigid_motion(toy, angle: float, x: float, mirrored: bool):
    folded = fold_at(toy[0], 0.3)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved = (folded * [1.0, -1.0] if mirrored else folded) @ turn + [x, 0.0]
    there, back = signs(folded, toy), signs(moved, toy)
    assert there.length_error_fraction == pytest.approx(back.length_error_fraction, abs=0.02)
    assert there.overlap_fraction == pytest.approx(back.overlap_fraction, abs=0.02)


def test_a_map_of_another_size_is_bent(toy):
    assert signs(0.7 * toy[0], toy).length_error_fraction > 0.9


def test_the_worst_sign_decides():
    assert FoldScore(2.0 * LENGTH_ERROR_LIMIT, 0.0).folded
    assert FoldScore(0.0, 2.0 * OVERLAP_LIMIT).folded
    assert not FoldScore(0.9 * LENGTH_ERROR_LIMIT, 0.9 * OVERLAP_LIMIT).folded
