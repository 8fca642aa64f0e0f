"""Angles of coarse encoders: close to the true ones between counts, and logs of such robots become right recordings."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepgps.robot_io.logs.importing import import_log
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.wheels import Wheels, fill_counts
from deepgps.terminal.progress import ignore
from sim.recording.format import open_recording
from tests.helpers.robot_log import (
    CONFIG,
    JOINTS,
    LENGTHS_M,
    RADIUS_M,
    TURNS,
    Note,
    change,
    make_motion,
    make_notes,
    set_fields,
    write_log,
)


def make_wheels(ticks: int, period_s: float, rounding: Any = np.floor) -> tuple[Wheels, np.ndarray]:
    """The wheels of the test drive with an encoder of so many ticks, and their true angles (n, 2) [rad]."""
    motion, tick = make_motion(), 2 * np.pi / ticks
    time_s = np.arange(0.0, motion.time_s[-1], period_s)
    true = np.column_stack([np.interp(time_s, motion.time_s, wheel) for wheel in motion.angle.T])
    none = np.zeros(len(time_s) - 1, bool)
    return Wheels(time_s, rounding(true / tick) * tick, none, none), true


def test_angles_between_counts_are_closer_to_the_true_ones():
    for ticks, period_s, rounding in product((8, 16, 32), (0.02, 0.05), (np.floor, np.rint)):
        wheels, true = make_wheels(ticks, period_s, rounding)
        filled = fill_counts(wheels, "wheels").angle
        before, after = (one - true - np.median(one - true, axis=0) for one in (wheels.angle, filled))
        assert np.abs(after).max() <= 2 * np.pi / ticks
        turning = np.abs(np.gradient(true, period_s, axis=0)) > 3.0  # rad/s
        assert np.std(after[turning]) < 0.6 * np.std(before[turning])


def test_fine_encoders_and_wheels_that_never_turn_stay_as_they_are():
    for ticks in (1024, 4096):
        wheels, _ = make_wheels(ticks, 0.05)
        np.testing.assert_array_equal(fill_counts(wheels, "wheels").angle, wheels.angle)
    still = Wheels(wheels.time_s, np.zeros_like(wheels.angle), wheels.broken, wheels.gap)
    assert not fill_counts(still, "wheels").angle.any()


def bring_in(ticks: int, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    tick = 2 * np.pi / ticks

    def count(_: int, note: Note) -> Note:
        return set_fields(note, position=np.floor(np.asarray(note.fields["position"]) / tick) * tick)

    log = write_log(tmp_path / "log", change(make_notes("image/jpeg"), JOINTS, count), "mcap_lz4")
    wheels = {**CONFIG["wheels"], "ticks_per_rev": ticks}
    config = RobotConfig.model_validate({**CONFIG, "wheels": wheels, "drive": {"spacing_m": 0.1, "held_out": 0.0}})
    return tmp_path / "recording", import_log(log, config, tmp_path / "recording", ignore)


@pytest.mark.slow
@pytest.mark.parametrize("ticks", [16, 32, 64])
def test_the_log_of_coarse_encoders_has_every_segment_and_turn(ticks: int, tmp_path: Path):
    folder, _ = bring_in(ticks, tmp_path)
    recording = open_recording(folder)
    driven = recording.reading[:, 2:].mean(axis=1) * 2 * np.pi / ticks * RADIUS_M
    lengths = [np.ptp(driven[recording.reading[:, 0] == number]) for number in np.unique(recording.reading[:, 0])]
    np.testing.assert_allclose(lengths, LENGTHS_M, atol=1.5 * 2 * np.pi / ticks * RADIUS_M)
    turns = recording.turns
    assert turns is not None and turns.kind.tolist() == [0] * len(TURNS)


@pytest.mark.slow
def test_encoders_that_are_too_coarse_are_noted(tmp_path: Path):
    _, about = bring_in(4, tmp_path)
    assert f"{JOINTS}: an encoder counts 4 ticks a turn of its wheel: turns in place may be missed" in about["notes"]
