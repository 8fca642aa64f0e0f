"""Training observations that look like a test observation are found whichever way it is turned."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deepgps.viewer import places
from deepgps.viewer.places import find_alike


def make_recording(observation: np.ndarray, kind: str) -> Any:
    return SimpleNamespace(observation=observation, kind=kind)


@pytest.mark.parametrize(
    ("kind", "shape"),
    [("polar_image", (16, 128, 3)), ("polar_image", (5, 61, 3)), ("scan", (4, 45)), ("vector", (12,))],
)
def test_an_observation_is_most_like_itself_at_any_turn(kind: str, shape: tuple[int, ...], monkeypatch) -> None:
    monkeypatch.setattr(places, "CHUNK", 7)
    rng = np.random.default_rng(0)
    known = rng.integers(0, 255, (20, *shape)).astype(np.uint8 if kind == "polar_image" else np.float32)
    turns = {128: 6, 45: 9}.get(shape[-2] if kind == "polar_image" else shape[-1], 0)
    tests = np.roll(known, turns, axis=2) if turns else known
    found = find_alike(make_recording(known, kind), tests, 2)
    assert found.shape == (20, 2)
    np.testing.assert_array_equal(found[:, 0], np.arange(20))


def test_of_a_long_recording_every_few_observations_are_compared(monkeypatch) -> None:
    monkeypatch.setattr(places, "MAX_COMPARED", 10)
    known = np.random.default_rng(1).normal(size=(30, 6)).astype(np.float32)
    found = find_alike(make_recording(known, "vector"), known[[3, 12]], 1)
    np.testing.assert_array_equal(found[:, 0], [3, 12])
