"""Turned parts: none in a right map or its mirror image; what is mirrored or turned is found, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.evaluation.map_errors import find_turned_parts
from deepgps.tracking.motion import rotate
from sim.recording.format import Recording, open_recording, open_truth


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


@pytest.fixture(scope="module")
def places(recording: Recording) -> np.ndarray:
    return open_truth(recording.folder).pose[:, :2]


def test_a_right_map_and_its_mirror_image_have_no_turned_part(recording: Recording, places: np.ndarray):
    for mirror in (1.0, -1.0):
        found = find_turned_parts(places * [1.0, mirror] @ rotate(np.array(1.2)) + 3.0, recording)["turned"]
        assert found["turns"] > 10 and found["share"] == 0.0 and not found["parts"]


def test_a_part_that_is_mirrored_is_found(recording: Recording, places: np.ndarray):
    middle = np.median(places[:, 0])
    folded = places.copy()
    beyond = places[:, 0] > middle
    folded[beyond, 0] = 2 * middle - folded[beyond, 0]  # folded over along a line: each segment beyond keeps its length
    found = find_turned_parts(folded, recording)["turned"]
    assert found["parts"] and 0.05 < found["share"] < 0.6
