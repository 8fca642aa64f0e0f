"""Readings that no drive leaves are refused in one line; those of every encoder are accepted."""

from itertools import product

import numpy as np
import pytest

from deepgps.data.checks import check_readings
from sim.errors import InputError
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import EncoderSettings
from tests.helpers.synthetic_run import TICKS_PER_REV, TRACK_M, WHEEL_RADIUS_M, make_drive, make_free_space

ODOMETRY = {"wheel_radius_m": WHEEL_RADIUS_M, "track_m": TRACK_M, "ticks_per_rev": TICKS_PER_REV}
POSE, READING, TIME, ANGLE = make_drive(make_free_space(), 500, np.random.default_rng(0))
JUMP = np.array([0, 0, 10**5, 10**5])
FAULTS = (
    {},
    {"slip_per_m": 0.3},
    {"step_noise": 1.0},
    {"dropout": 0.9},
    {"stuck_fraction": 0.9},
    {"step_noise": 0.3, "dropout": 0.5, "slip_per_m": 0.05, "stuck_fraction": 0.2},
)


def check(reading: np.ndarray, time: np.ndarray = TIME, odometry: dict = ODOMETRY) -> None:
    check_readings(reading, time, len(POSE), odometry)


def mix(values: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).permutation(values)


def test_what_is_no_record_of_a_drive_is_refused():
    for reading, time, names in (
        (READING[:, :3], TIME, r"readings .*\d, 3"),
        (READING[:0], TIME[:0], r"readings .*0, 4"),
        (READING, TIME[:-1], "time .*readings"),
        (READING.astype("S8"), TIME, "readings .*S8"),
        (READING.astype(float), TIME, "readings .*integers"),
        (READING, TIME[::-1], "time"),
        (READING, np.where(np.arange(len(TIME)) == 7, np.nan, TIME), "time.* reading 7"),
        (READING[mix(np.arange(len(READING)))], TIME, "readings"),
        (READING + np.array([0, 10**6, 0, 0]), TIME, "readings.*observations"),
        (READING * np.array([1, 1, 1, 0]), TIME, "right wheel"),
        (READING * np.array([1, 1, 1000, 1000]), TIME, "m/s"),
        (READING + (np.arange(len(READING)) >= 33)[:, None] * JUMP, TIME, "reading 33"),
    ):
        with pytest.raises(InputError, match=names):
            check(reading, time)


def test_readings_of_every_encoder_are_accepted():
    for ticks, faults in product((4, 64, 4096, 65536), FAULTS):
        settings = EncoderSettings(ticks_per_rev=ticks, **faults)  # pyright: ignore
        odometry = describe_odometry(settings, WHEEL_RADIUS_M, TRACK_M)
        for seed in range(5):
            counted, arrived = read_encoders(ANGLE, WHEEL_RADIUS_M, settings, np.random.default_rng(seed))
            check(np.column_stack([READING[:, :2], counted])[arrived], TIME[arrived], odometry)
