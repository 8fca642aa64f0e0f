"""A plugin for tests: a method for any observations, which stores what it has seen, and a random encoder fault."""

from pathlib import Path

CODE = """
import numpy as np
from scipy.spatial import KDTree

import deepgps
from deepgps.data.segments import dead_reckon


def fit(recording, settings, seed, folder, progress):
    seen, first = np.unique(recording.reading[:, 1], return_index=True)
    stored = np.asarray(recording.observation[seen]).reshape(len(seen), -1)
    return deepgps.Fitted({"stored": stored, "place": dead_reckon(recording)[first, :2]})


def predict(arrays, observations):
    return arrays["place"][KDTree(arrays["stored"]).query(observations.reshape(len(observations), -1))[1]]


def stretch(angle, value, wheel_radius_m, rng):
    return angle * (1.0 + value * rng.random())


METHODS = {"stored": deepgps.Method("Stored", "#aa3377", "SE2", fit, predict=predict, in_steps=False)}
ENCODER_FAULTS = {"stretch": deepgps.EncoderFault("stretch of all distances", apply=stretch)}
"""
CHANGES = {"scenario": "plane.yaml", "methods": ["stored"], "cases": [{}], "report": "curves", "target": {}}
"""What makes the small study one of this method."""


def write_plugin(folder: Path) -> Path:
    """Write the plugin."""
    (folder / "stored.py").write_text(CODE)
    return folder / "stored.py"
