"""The rule of clocks on arrays: what shares one clock is used as it is stamped, a few outliers are left out, and the
rest is refused; the times of logging count only where they advance as the stamps do."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.robot_io.logs.clocks import choose_times
from sim.errors import InputError

START_NS, DRIVE_S = 1_700_000_000 * 10**9, 40.0
PERIOD_S = {"wheels": 0.05, "camera": 0.1}
TIME_S = {topic: np.arange(0.03, DRIVE_S, period_s) for topic, period_s in PERIOD_S.items()}


def make(**changes: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times of logging and stamps [ns] with delays of some ms; a change is added to the stamps of its topic [s]."""
    rng, logs = np.random.default_rng(0), {}
    for topic, time_s in TIME_S.items():
        logged_s = np.maximum.accumulate(time_s + 0.003 + rng.exponential(0.002, len(time_s)))
        stamp_s = time_s + changes.get(topic, 0.0)
        logs[topic] = tuple(START_NS + np.rint(1e9 * one).astype(np.int64) for one in (logged_s, stamp_s))
    return logs


def change(topic: str, begin_s: float, end_s: float, by_s: float) -> dict[str, np.ndarray]:
    time_s = TIME_S[topic]
    return {topic: by_s * ((time_s >= begin_s) & (time_s < end_s))}


def check_times(logs: dict, logged: bool, within_s: float = 0.02, lost: int = 0) -> None:
    """All times but some are the true ones, but for a constant of the topic."""
    for topic, time_s in choose_times(logs, logged).time_s.items():
        error_s = time_s - TIME_S[topic]
        assert np.isnan(error_s).sum() <= lost
        assert np.nanmax(np.abs(error_s - np.nanmedian(error_s))) <= within_s


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from(sorted(TIME_S)),
    st.floats(1.0, DRIVE_S - 2.0),
    st.floats(0.4, 60.0),
    st.sampled_from((-1, 1)),
    st.floats(0.06, 9.0),
)
def test_a_clock_that_is_set_or_jumps_for_a_while_is_refused_and_times_of_logging_are_right(
    topic: str, begin_s: float, for_s: float, sign: int, by_s: float
) -> None:
    """Also within the first ten seconds, and in a burst of a few messages."""
    logs = make(**change(topic, begin_s, begin_s + for_s, sign * by_s))
    way = "ahead" if sign > 0 else "back"
    said = rf"the clock of {topic} is set {way} by ([\d.]+) s at ([\d.]+) s.*; clocks: logged takes"
    with pytest.raises(InputError, match=said) as caught:
        choose_times(logs, False)
    found = re.match(said, str(caught.value))
    assert found
    size_s, at_s = map(float, found.groups())
    assert abs(size_s - by_s) < 0.02 and abs(at_s - begin_s) < 0.2
    check_times(logs, True)


@given(st.sampled_from((-1, 1)), st.floats(0.5, 1e8), st.floats(-1e-4, 1e-4))
def test_clocks_apart_are_refused_and_times_of_logging_are_right(sign: int, apart_s: float, drift: float) -> None:
    logs = make(camera=sign * apart_s + drift * TIME_S["camera"])
    with pytest.raises(InputError, match=r"the clock of camera differs from that of wheels by [+-]\d+"):
        choose_times(logs, False)
    check_times(logs, True)


@given(st.lists(st.integers(5, 390), min_size=1, max_size=4, unique=True), st.floats(0.2, 1e8), st.booleans())
def test_a_few_outliers_are_left_out_with_their_number(rows: list[int], by_s: float, ahead: bool) -> None:
    rows = [row for row in rows if not {row - 1, row - 2} & {*rows}]
    stamp = np.zeros(len(TIME_S["camera"]))
    stamp[rows] = by_s if ahead else -by_s
    logs = make(camera=stamp)
    (note,) = choose_times(logs, False).notes
    assert note.startswith(f"camera: {len(rows)} messages are left out")
    check_times(logs, False, 1e-6, len(rows))


def test_many_outliers_are_refused() -> None:
    stamp = np.zeros(len(TIME_S["camera"]))
    stamp[10:200:20] = 4.0
    with pytest.raises(InputError, match=r"camera: 10 of 400 messages are stamped otherwise than .*, first at 1\.0 s"):
        choose_times(make(camera=stamp), False)


@given(st.floats(0.05, 1.0), st.floats(-5.0, 5.0))
def test_a_slow_simulation_is_one_clock_and_its_times_of_logging_are_refused(factor: float, start_s: float) -> None:
    logs = make()
    slow = {
        topic: (START_NS + ((log - START_NS) / factor).astype(np.int64), stamp) for topic, (log, stamp) in logs.items()
    }
    check_times(slow, False, 1e-6)
    if factor < 0.4:
        with pytest.raises(InputError, match="clocks: logged: wheels: times of logging and stamps advance differently"):
            choose_times(slow, True)


@given(st.integers(0, 99), st.floats(0.1, 1.0))
def test_a_simulation_that_halts_and_messages_that_are_held_up_keep_their_stamps(seed: int, most_s: float) -> None:
    rng, logs = np.random.default_rng(seed), make()
    at_s, halt_s = np.sort(rng.uniform(1.0, DRIVE_S, 20)), rng.uniform(0.0, most_s, 20)
    for topic, (log, stamp) in logs.items():
        halted_s = (TIME_S[topic][:, None] > at_s) @ halt_s
        held_s = rng.uniform(0.0, 0.3, len(log)) * (rng.random(len(log)) < 0.1)
        held = np.maximum.accumulate(log + (1e9 * (halted_s + held_s)).astype(np.int64) + np.arange(len(log)))
        logs[topic] = held, stamp
    check_times(logs, False, 1e-6)


@given(st.integers(2, 40), st.booleans())
def test_messages_that_arrive_in_bursts_keep_their_stamps(size: int, reverse: bool) -> None:
    """They are held up, and the last of them arrives at its time; in any order."""
    logs = make()
    log, stamp = logs["wheels"]
    together = np.arange(len(log)) // size
    last = np.maximum.reduceat(log, np.flatnonzero(np.diff(together, prepend=-1)))[together]
    held = np.arange(len(log)) % size
    logs["wheels"] = last + (100_000 * (size - held if reverse else held)), stamp
    for logged in (False, True):
        check_times(logs, logged)


def test_without_stamps_only_times_of_logging_count() -> None:
    for none in (lambda stamp: 0 * stamp, lambda stamp: 0 * stamp + START_NS, lambda stamp: stamp // 10**6):
        logs = make()
        log, stamp = logs["camera"]
        logs["camera"] = log, none(stamp)
        with pytest.raises(
            InputError, match="camera: most messages have no stamp, or stamps do not advance; clocks: l"
        ):
            choose_times(logs, False)
        check_times(logs, True, 0.03)
    logs["camera"] = START_NS + (log - START_NS) // 10**9 * 10**9, 0 * stamp
    with pytest.raises(InputError, match="clocks: logged: camera: messages without stamps were logged in bursts"):
        choose_times(logs, True)


@pytest.mark.parametrize("far_s", [-1e8, 1e8])
def test_a_message_logged_years_from_the_others_changes_nothing(far_s: float) -> None:
    logs = make()
    log, _ = logs["wheels"]
    log[300] += int(far_s * 1e9)
    check_times(logs, False, 1e-6, 1)
