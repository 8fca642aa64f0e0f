"""Checks of a recording before it is learned from: its readings, and its field of view.

Recordings that a simulation made are protected by their checksums, and the import of a log checks the wheels at their
own rate; the checks of readings are for arrays of one's own. Polar images must have the same field of view where a
method learns and where it is used.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim.errors import InputError
from sim.recording.format import Recording
from sim.sensors.encoder import check_odometry, count_from_first, measure_tick

MAX_ANGLE_DIFFERENCE_DEG = 2.0  # Difference of two fields of view that moves no pixel by more than a ring or so [deg]


def find_view(recording: Recording) -> float | None:
    """Full angle of a recording's polar images [deg]; None: its manifest does not tell."""
    camera = recording.manifest.settings.get("camera", {})
    return camera.get("field_of_view_deg") if isinstance(camera, dict) else None


def check_view(used_deg: float, learned_deg: float | None) -> None:
    """Raise InputError if images of this field of view are not like those that were learned from; None: unknown."""
    if learned_deg is not None and abs(used_deg - learned_deg) > MAX_ANGLE_DIFFERENCE_DEG:
        raise InputError(
            f"camera.field_of_view_deg {used_deg:g}: the run has learned from images of {learned_deg:g}, so no place "
            "would be found; set the same, or leave it out"
        )


MAX_SPEED_MPS = 10.0
"""Highest credible speed of a wheel of a robot in a room [m/s]; a counter that wraps around or restarts exceeds it."""
ROUNDING_TICKS = 3  # Ticks that a gap of any length may be off by
MIN_GAPS = 100  # If one wheel turns in so many gaps and the other in none, the other's counter counts as dead


def check_recording(recording: Recording) -> None:
    """Raise InputError if a recording's readings cannot be those of a drive."""
    if recording.manifest.source == "log":
        return
    try:
        odometry = check_odometry(recording.manifest.odometry)
        check_readings(recording.reading, recording.time, len(recording.observation), odometry)
    except InputError as error:
        raise InputError(f"{recording.folder}: {error}") from None


def check_readings(reading: np.ndarray, time: np.ndarray, observations: int, odometry: Mapping[str, Any]) -> None:
    """Raise InputError if readings cannot be those of a drive with so many observations.

    Readings (R, 4) are segment, observation, cumulative left and right ticks, in the order driven, with times (R,) [s].
    """
    if reading.ndim != 2 or reading.shape[1] != 4 or not len(reading):
        raise InputError(f"readings {reading.shape}: must have rows of 4 numbers, at least one")
    for name, array, kinds in (("readings", reading, "iu"), ("time", time, "iuf")):
        if array.dtype.kind not in kinds:
            raise InputError(f"{name} {array.dtype}: must be {'integers' if kinds == 'iu' else 'numbers'}")
    if time.shape != reading.shape[:1]:
        raise InputError(f"time {time.shape}: must have the shape {reading.shape[:1]}, one for each of the readings")
    gap, seconds = np.diff(reading.astype(np.int64), axis=0), np.diff(time.astype(float))
    for name, wrong in (
        ("time: no number, or no increase, at", ~(seconds > 0)),
        ("readings: the segment decreases at", gap[:, 0] < 0),
        ("readings: the observation decreases at", gap[:, 1] < 0),
    ):
        if wrong.any():
            raise InputError(f"{name} reading {int(wrong.argmax()) + 1}")
    if reading[0, 1] < 0 or reading[-1, 1] >= observations:
        raise InputError(f"readings: the observations must be numbers from 0 to {observations - 1}")
    _check_ticks(np.diff(count_from_first(reading[:, 2:]), axis=0), seconds, gap[:, 0] == 0, measure_tick(odometry))


MAX_VALUE = 1e9  # Larger numbers are refused as observations: their squares could exceed the range of float32
CHUNK = 64


def check_observations(observation: np.ndarray, name: str) -> None:
    """Raise InputError if observations are unusable: not numeric, not finite, or far too large."""
    if observation.dtype.kind not in "uif":
        raise InputError(f"{name} holds {observation.dtype}, but must hold numbers")
    if observation.dtype.kind != "f":
        return
    wrong = 0
    for start in range(0, len(observation), CHUNK):
        part = np.asarray(observation[start : start + CHUNK])
        able = np.isfinite(part) & (np.abs(part) <= MAX_VALUE)
        wrong += int((~able).reshape(len(part), -1).any(axis=1).sum())
    if wrong:
        raise InputError(
            f"{name}: {wrong} of {len(observation)} observations hold NaN, infinity or a number beyond {MAX_VALUE:g}"
        )


def _check_ticks(gap: np.ndarray, seconds: np.ndarray, inside: np.ndarray, tick_m: float) -> None:
    speed_mps = (np.abs(gap).max(axis=1, initial=0) - ROUNDING_TICKS).clip(0) * tick_m / seconds
    if (speed_mps > MAX_SPEED_MPS).any():
        row = int(speed_mps.argmax())
        raise InputError(
            f"readings, time: a wheel drives {speed_mps[row]:.3g} m/s before reading {row + 1}, but at most "
            f"{MAX_SPEED_MPS:g} m/s is plausible; ticks, times or the manifest's odometry are wrong"
        )
    turned = (gap[inside] != 0).sum(axis=0)
    for name, own, other in (("left", *turned), ("right", *turned[::-1])):
        if own == 0 and other >= MIN_GAPS:
            raise InputError(
                f"readings: the {name} wheel never counts on a segment, while the other does {other} times"
            )
