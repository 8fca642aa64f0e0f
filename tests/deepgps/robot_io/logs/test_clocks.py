"""One time for several topics: a message that is logged far from all others changes nothing, and costs no memory."""

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from deepgps.robot_io.logs.drive import Aligned, Times, align

PERIOD_S, DRIVE_S = 0.05, 200.0


@contextmanager
def at_most(megabytes: float) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < megabytes * 1e6
    finally:
        tracemalloc.stop()


def make_topics(apart_s: float, set_back_s: float, far_s: float | None = None) -> list[Times]:
    """Wheels and a camera whose clocks differ, one of which is set back; one message is logged far from the others."""
    log_s = np.arange(0.0, DRIVE_S, PERIOD_S)
    wheels_s = log_s - 0.003 - set_back_s * (log_s > DRIVE_S / 2)
    camera_s = log_s - 0.01 - apart_s
    if far_s is not None:
        log_s, wheels_s, camera_s = (np.append(values, far_s) for values in (log_s, wheels_s, camera_s))
    return [Times("wheels", log_s, wheels_s), Times("camera", log_s, camera_s)]


def align_all(topics: list[Times]) -> Aligned:
    with at_most(megabytes=10):
        return align(topics, may_align=True)


@pytest.mark.parametrize("far_s", [-1e8, 1e8, 1e8 + 3.0], ids=["before", "after", "within a stretch"])
@pytest.mark.parametrize(("apart_s", "set_back_s"), [(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 0.4)])
def test_a_message_logged_years_from_the_others_changes_nothing(
    apart_s: float, set_back_s: float, far_s: float
) -> None:
    usual = align_all(make_topics(apart_s, set_back_s))
    found = align_all(make_topics(apart_s, set_back_s, far_s))
    assert found.by_log == usual.by_log and len(found.notes) == len(usual.notes)
    for topic, time_s in usual.time_s.items():
        np.testing.assert_allclose(found.time_s[topic][:-1], time_s, atol=0.011)


def test_a_clock_that_is_set_ahead_changes_times_near_the_jump_only() -> None:
    usual, found = align_all(make_topics(0.0, 0.0)), align_all(make_topics(0.0, -2.0))
    apart = np.abs(found.time_s["wheels"] - usual.time_s["wheels"])
    assert np.isfinite(apart).mean() > 0.5 and np.nanmax(apart) < 0.02


@pytest.mark.parametrize("stamp", ["constant", "in ms"])
def test_stamps_that_do_not_advance_are_none(stamp: str) -> None:
    log_s = np.arange(0.0, DRIVE_S, PERIOD_S)
    stamp_s = np.zeros(len(log_s)) if stamp == "constant" else log_s * 1e-6
    assert not Times("camera", log_s, stamp_s).is_stamped
    assert Times("camera", log_s, log_s - 0.01).is_stamped
