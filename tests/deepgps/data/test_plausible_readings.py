"""Readings that cannot be: clean ones stay as they are; faults change no distance but those of what is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.data.dead_reckoning import dead_reckon
from deepgps.data.plausible_readings import (
    CheckedReadings,
    check_readings,
    count_readings,
    describe_readings,
    keep_plausible,
)
from deepgps.data.segments import Segments, read_segments
from sim.errors import InputError
from sim.recording.format import Recording, open_recording
from sim.recording.manifest import Manifest
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import EncoderSettings
from tests.helpers.synthetic_run import TICKS_PER_REV, TRACK_M, WHEEL_RADIUS_M, make_drive, make_free_space

ODOMETRY = {"wheel_radius_m": WHEEL_RADIUS_M, "track_m": TRACK_M, "ticks_per_rev": TICKS_PER_REV}
POSE, READING, TIME, ANGLE = make_drive(make_free_space(), 500, np.random.default_rng(0))
SEEDS = range(20)
LEFT_OUT = ("not_a_number", "out_of_range", "repeated", "disordered", "jumps")


def check(reading: np.ndarray, time: np.ndarray = TIME) -> CheckedReadings:
    return check_readings(reading, time, len(POSE), ODOMETRY)


def measure(reading: np.ndarray, odometry: dict = ODOMETRY) -> Segments:
    empty = np.zeros((0, 2))
    return read_segments(Recording(Path("made-up"), Manifest(odometry=odometry), empty, reading, TIME, empty))


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    """The same segments, readings and distances to the bit, whatever the segments' numbers are."""
    one, other = measure(found), measure(expected)
    assert one.count.tolist() == other.count.tolist()
    assert one.index.equal(other.index)
    assert one.distance.equal(other.distance)


def without(chosen: np.ndarray) -> np.ndarray:
    return np.delete(READING, chosen, axis=0)


def choose(rng: np.random.Generator, most: int = 12) -> np.ndarray:
    return rng.choice(len(READING), rng.integers(1, most + 1), replace=False)


@pytest.mark.parametrize("ticks", [4, 64, 4096, 65536])
@pytest.mark.parametrize(
    "faults",
    [
        {},
        {"slip_per_m": 0.3},
        {"step_noise": 0.3},
        {"step_noise": 1.0},
        {"dropout": 0.9},
        {"stuck_fraction": 0.9},
        {"radius_error_left": 0.2},
        {"step_noise": 0.3, "dropout": 0.5, "slip_per_m": 0.05, "stuck_fraction": 0.2},
    ],
    ids=str,
)
def test_of_clean_encoders_no_reading_is_touched(ticks: int, faults: dict):
    settings = EncoderSettings(ticks_per_rev=ticks, **faults)
    for seed in SEEDS:
        counted, arrived = read_encoders(ANGLE, WHEEL_RADIUS_M, settings, np.random.default_rng(seed))
        reading = np.column_stack([READING[:, :2], counted])[arrived]
        odometry = describe_odometry(settings, WHEEL_RADIUS_M, TRACK_M)
        checked = check_readings(reading, TIME[arrived], len(POSE), odometry)
        assert checked.reading is reading
        assert checked.counts == {"kept": len(reading), **dict.fromkeys((*LEFT_OUT, "wrapped", "breaks"), 0)}


def slow_down(share: float, times: float) -> np.ndarray:
    """Times of the readings of a robot that drives a part of its segments slower."""
    slow = np.random.default_rng(0).random(READING[-1, 0] + 1) < share
    on_slow = slow[READING[1:, 0]] & (np.diff(READING[:, 0]) == 0)
    return TIME[0] + np.append(0.0, np.cumsum(np.diff(TIME) * np.where(on_slow, times, 1.0)))


@pytest.mark.parametrize("times", [1.5, 3.0, 5.0])
@pytest.mark.parametrize("share", [0.1, 0.4, 0.6, 0.8])
def test_a_robot_may_drive_at_two_speeds(share: float, times: float):
    time = slow_down(share, times)
    assert check(READING, time).reading is READING
    chosen, reading = choose(np.random.default_rng(1)), READING.copy()
    reading[chosen, 2:] += 10**6
    found, left = check(reading, time), np.delete(np.arange(len(READING)), chosen)
    assert np.array_equal(np.flatnonzero(found.kept), left)


def test_a_real_recording_stays_as_it_is(small_recording: Path):
    recording = open_recording(small_recording)
    checked = keep_plausible(recording)
    assert checked.reading is recording.reading
    assert count_readings(recording) == {}
    assert describe_readings(count_readings(checked)["readings"]) is None
    assert keep_plausible(checked) is checked


@pytest.mark.parametrize("seed", SEEDS)
def test_jumps_are_left_out(seed: int):
    rng = np.random.default_rng(seed)
    chosen, reading = choose(rng), READING.copy()
    size = np.exp(rng.uniform(np.log(2.0**17), np.log(2.0**62), (len(chosen), 2))).astype(np.int64)
    both = rng.integers(0, 2, (len(chosen), 2))
    both[np.arange(len(chosen)), rng.integers(0, 2, len(chosen))] = 1  # one wheel at least
    reading[chosen, 2:] += size * rng.choice([-1, 1], (len(chosen), 2)) * both
    assert_same(check(reading).reading, without(chosen))


def test_a_jump_of_a_metre_among_gaps_of_eight_centimetres_is_left_out():
    inner = 1 + np.flatnonzero((np.diff(READING[:-1, 0]) == 0) & (np.diff(READING[1:, 0]) == 0))
    for chosen in inner[::25]:
        reading = READING.copy()
        reading[chosen, 2:] += 20_000
        assert check(reading).counts["jumps"] == 1
        assert_same(check(reading).reading, without(chosen))


@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_counters_that_wrap_around_are_unwrapped(bits: int, signed: bool, seed: int):
    rng, full = np.random.default_rng(seed), 2**bits
    low = -full // 2 if signed else 0
    # Somewhere on a segment each wheel's counter is at its end.
    inner = np.flatnonzero(np.diff(READING[:, 0]) == 0)
    at = [READING[place + 1, 2 + wheel] - 1 for wheel, place in enumerate(rng.choice(inner, 2))]
    reading = READING.copy()
    reading[:, 2:] = (reading[:, 2:] - at) % full + low
    checked = check(reading)
    assert checked.counts["wrapped"] >= 1
    assert checked.counts["kept"] == len(READING)
    assert np.array_equal(np.diff(checked.reading, axis=0), np.diff(READING, axis=0))
    assert_same(checked.reading, READING)


def test_a_counter_of_16_bits_is_unwrapped_where_a_gap_is_a_third_of_its_range():
    counted = np.floor(ANGLE * 65536 / (2 * np.pi)).astype(np.int64)
    odometry = {**ODOMETRY, "ticks_per_rev": 65536}
    reading = np.column_stack([READING[:, :2], counted % 2**16])
    found = measure(check_readings(reading, TIME, len(POSE), odometry).reading, odometry)
    assert found.distance.equal(measure(np.column_stack([READING[:, :2], counted]), odometry).distance)


@pytest.mark.parametrize("step", [2**17, -(10**9), 2**16, 2**62])
def test_where_a_counter_is_reset_a_segment_is_divided(step: int):
    inner = 1 + np.flatnonzero(np.diff(READING[:, 0]) == 0)
    for chosen in inner[8:-8:60]:
        reading = READING.copy()
        reading[chosen:, 2] += step
        divided = READING.copy()
        divided[chosen:, 0] += step != 2**16  # that is a wrap, and nothing is lost
        assert_same(check(reading).reading, divided)
        assert check(reading).counts["breaks"] == int(step != 2**16)


def test_a_counter_that_is_reset_at_a_turn_tells_no_turn(small_recording: Path):
    recording = open_recording(small_recording)
    assert recording.turns is not None
    after = int(recording.turns.after[3])
    reading = recording.reading.copy()
    reading[after:, 2:] -= 10**6
    found = keep_plausible(replace(recording, reading=reading)).turns
    assert found is not None
    assert found.after.tolist() == [row for row in recording.turns.after.tolist() if row != after]


@pytest.mark.parametrize("seed", SEEDS)
def test_readings_out_of_their_order_or_range_are_left_out(seed: int):
    rng = np.random.default_rng(seed)
    chosen, time, reading = choose(rng), TIME.copy(), READING.copy()
    time[chosen[0::4]] = rng.choice([np.nan, np.inf, -np.inf], len(chosen[0::4]))
    time[chosen[1::4]] -= 1e6
    reading[chosen[2::4], 1] = rng.choice([-1, -(10**6), len(POSE), 10**6], len(chosen[2::4]))
    reading[chosen[3::4], 0] += rng.choice([-(10**6), 10**6], len(chosen[3::4]))
    checked = check(reading, time)
    assert_same(checked.reading, without(chosen))
    assert checked.counts["not_a_number"] == len(chosen[0::4])
    assert checked.counts["out_of_range"] == len(chosen[2::4])
    assert checked.counts["disordered"] == len(chosen[1::4]) + len(chosen[3::4])
    assert np.array_equal(np.flatnonzero(~checked.kept), np.sort(chosen))


def test_repeated_readings_count_once():
    again = np.insert(np.arange(len(READING)), [40, 41, 300], [40, 41, 300])
    checked = check(READING[again], TIME[again])
    assert checked.counts["repeated"] == 3
    assert np.array_equal(checked.reading, READING)


def test_readings_that_are_no_numbers_are_left_out():
    reading = READING.astype(float)
    reading[[3, 50]] = np.nan
    reading[70, 2] = 0.5
    checked = check(reading)
    assert checked.counts["not_a_number"] == 3
    assert np.array_equal(checked.reading, without(np.array([3, 50, 70])))


@pytest.mark.parametrize("offset", [2**40, 2**62, -(2**63), 2**63 - 1 - int(READING[200, 2])])
def test_ticks_near_the_end_of_64_bits_give_the_same_distances(offset: int):
    reading = READING.copy()
    reading[:, 2:] += np.array([offset]).astype(np.int64)  # and around the end in the last case
    checked = check(reading)
    assert checked.counts["kept"] == len(READING)
    found, expected = measure(checked.reading), measure(READING)
    assert np.allclose(found.distance, expected.distance, rtol=0, atol=1e-6)
    empty = np.zeros((0, 2))
    path, known = (
        dead_reckon(Recording(Path("made-up"), Manifest(odometry=ODOMETRY), empty, table, TIME, empty))
        for table in (checked.reading, READING)
    )
    assert np.allclose(path, known, rtol=0, atol=1e-9)


def test_wheels_that_never_turn_are_no_jump():
    reading = READING * np.array([1, 1, 0, 0])
    assert check(reading).reading is reading


def test_turns_that_are_taken_for_a_segment_divide_it_again():
    at_once = READING * np.array([0, 1, 1, 1])
    turn = np.abs(np.diff(READING[:, 3] - READING[:, 2]))[np.diff(READING[:, 0]) == 1]
    checked = check(at_once)
    assert checked.counts["wrapped"] == 0
    assert checked.counts["kept"] == len(READING)
    assert checked.counts["breaks"] >= 0.9 * (turn > 1000).sum()


@pytest.mark.parametrize(
    ("reading", "time", "message"),
    [
        (READING[:, :3], TIME, r"reading.npy has the shape \(\d+, 3\), but must have rows of 4 numbers"),
        (READING[:0], TIME[:0], r"reading.npy has the shape \(0, 4\)"),
        (READING, TIME[:-1], r"time.npy has the shape \(\d+,\), but reading.npy has \d+ readings"),
        (READING.astype("S8"), TIME, r"reading.npy holds \|S8, but must hold numbers"),
        (READING, TIME[::-1], r"are impossible \(\d+ are out of order\)"),
        (READING, np.zeros(len(TIME)), r"are impossible \(\d+ are out of order\)"),
        (READING, np.full(len(TIME), np.nan), r"are impossible \(\d+ hold no number\)"),
        (np.random.default_rng(0).permutation(READING), TIME, r"are impossible \(\d+ are out of order\)"),
        (
            READING * np.array([1, 1, 1, 0]),
            TIME,
            "the right wheel never counts on a segment, while the other does 499 times",
        ),
        (
            READING * np.array([1, 1, 1000, 1000]),
            TIME,
            r"the wheels drive 220 m/s in the median, and more than 30 m/s is not",
        ),
        (
            np.column_stack([READING[:, :2], np.random.default_rng(0).permutation(READING[:, 2:])]),
            TIME,
            r"the wheels drive 31.9 m/s in the median",
        ),
        (
            READING + np.random.default_rng(0).integers(0, 2, (len(READING), 1)) * np.array([0, 0, 10**5, 10**5]),
            TIME,
            r"at \d+ of \d+ readings the ticks jump",
        ),
        (
            READING + (np.arange(len(READING)) % 8 == 3)[:, None] * np.array([0, 0, 10**5, 10**5]),
            TIME,
            r"at 65 of \d+ readings the ticks jump, so they are no counts of wheels",
        ),
        (READING + np.array([0, 10**6, 0, 0]), TIME, r"are impossible \(\d+ belong to no observation\)"),
    ],
)
def test_what_is_no_record_of_a_drive_is_refused(reading: np.ndarray, time: np.ndarray, message: str):
    with pytest.raises(InputError, match=message):
        check(reading, time)


def test_the_sentence_counts_all_that_was_done():
    reading = READING.copy()
    reading[40, 2:] += 10**9
    reading[200:, 3] -= 2**32
    counts = check(reading, np.where(np.arange(len(TIME)) == 90, np.nan, TIME)).counts
    assert describe_readings(counts) == (
        f"2 of {len(READING)} readings cannot be and are left out (1 hold no number, 1 jump); "
        "the counters of the wheels wrap around at 1 gaps, which are unwrapped."
    )
    assert describe_readings({}) is None


@pytest.mark.parametrize("ends_only", [False, True])
def test_turns_in_the_middle_of_a_segment_are_noticed(ends_only: bool):
    """Where all readings claim one segment, the wheels turn against each other on it, however few readings it has."""
    change = np.diff(READING[:, 0]) != 0
    chosen = np.append(True, change) | np.append(change, True) | (not ends_only)
    reading = READING[chosen] * np.array([0, 1, 1, 1])
    try:
        assert check(reading, TIME[chosen]).counts["breaks"] > 0
    except InputError as error:
        assert "jump" in str(error)
