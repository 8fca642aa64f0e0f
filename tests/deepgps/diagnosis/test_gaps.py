"""A stuck wheel is replaced by the other one: as if it had counted, where the wheels travel alike."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.data.segments import read_segments
from deepgps.diagnosis.gaps import mend_stuck
from sim.recording.format import Recording, open_recording


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


def stick(recording: Recording, wheel: int, first: int, last: int) -> Recording:
    ticks = np.diff(recording.reading[:, 2:], axis=0)
    ticks[first:last, wheel] = 0
    reading = recording.reading.copy()
    reading[1:, 2:] = reading[0, 2:] + np.cumsum(ticks, axis=0)
    return replace(recording, reading=reading)


def test_without_a_stuck_wheel_nothing_changes(recording: Recording):
    assert mend_stuck(recording) is recording


@pytest.mark.parametrize("wheel", [0, 1])
def test_lengths_of_segments_are_as_if_no_wheel_had_stuck(recording: Recording, wheel: int):
    stuck = stick(recording, wheel, 20, len(recording.reading) // 2)
    right, wrong, mended = (read_segments(one).distance for one in (recording, stuck, mend_stuck(stuck)))
    assert (wrong - right).abs().max() > 0.1
    assert (mended - right).abs().max() < 0.003, "wheels on a straight segment differ by a tick or two"
