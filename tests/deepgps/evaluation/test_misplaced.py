"""The share of training images that a map misplaces."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deepgps.evaluation.evaluate import FAR_M, measure_misplaced
from sim.files.checksums import read_json


def test_only_what_is_farther_off_than_the_limit_is_misplaced():
    rng = np.random.default_rng(0)
    pose = rng.uniform(-5.0, 5.0, (40, 3))
    angle, off = rng.uniform(-np.pi, np.pi, 40), np.r_[np.full(30, 0.99 * FAR_M), np.full(10, 1.01 * FAR_M)]
    places = pose[:, :2] + off[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert measure_misplaced(places, SimpleNamespace(pose=pose)) == pytest.approx(0.25)  # pyright: ignore[reportArgumentType]


def test_a_run_says_it_of_every_method(finished_run: Path):
    methods = read_json(finished_run / "metrics.json")["methods"]
    assert all(0.0 <= one["misplaced"] <= 1.0 for one in methods.values())
