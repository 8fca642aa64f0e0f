"""Clocks that nothing synchronises: what they read, and when their timers fire."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.robot_log.observe import DRIFT, EPOCH_NS, OFFSET_S, RECORDER, Clock, make_base_clock

clocks = st.builds(Clock, st.floats(-5, 5), st.floats(-1e-3, 1e-3))


@given(clocks)
def test_a_timer_s_period_is_exact_by_its_own_clock(clock):
    read = clock.read(clock.fire(0.1, 100.0)) - clock.read(np.zeros(1))
    np.testing.assert_allclose(read, 1e8 * np.arange(1, len(read) + 1), atol=2)


def test_the_computers_disagree_within_the_limits_and_the_recorder_reads_the_simulation_s_time():
    for seed in range(20):
        clock = make_base_clock(seed)
        assert OFFSET_S[0] <= abs(clock.offset_s) <= OFFSET_S[1]
        assert DRIFT[0] <= abs(clock.drift) <= DRIFT[1]
        assert clock == make_base_clock(seed) != make_base_clock(seed + 1)
        apart_s = (clock.read(np.array([0.0, 1000.0])) - RECORDER.read(np.array([0.0, 1000.0]))) / 1e9
        assert apart_s[1] - apart_s[0] == pytest.approx(1000 * clock.drift, abs=1e-6)
    assert RECORDER.read(np.array([1.5])) == EPOCH_NS + 1_500_000_000
