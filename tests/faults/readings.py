"""Readings that cannot be: written into a recording whose checksums fit, they are found, or do no harm."""

import hashlib
import json
import random
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import deepgps
from tests.faults.material import must_end, write_scenario

NEAR_M = 0.15
"""RMS of a run whose readings are as they were: 0.04 to 0.06 m over seeds; of one that learned wrongly: 0.3 m."""
CHANGED = {"learn.fold.restarts": 2, "methods": ["deepgps"]}
SAYS = re.compile(r"readings?\b.*\b(left out|cannot be|impossible|unwrapped|wrap|jump|doubted)")
Readings = tuple[np.ndarray, np.ndarray]
"""The array of readings (segment, observation, left ticks, right ticks) and their times."""
Change = Callable[[np.ndarray, np.ndarray, random.Random], Readings]


def list_tests() -> list[Test]:
    """Every change of the readings once, each drawn at random, and constants of the odometry."""
    return [
        Test("readings", "impossible readings, checksums corrected", 24, _attack, of=len(CHANGES)),
        Test("readings", "impossible odometry in the manifest", 4, _attack_odometry, of=len(ODOMETRY)),
    ]


def _attack(case: Case) -> Verdict:
    name = list(CHANGES)[case.number % len(CHANGES)]
    source, recording = _record(case.folder)
    reading, times = np.load(recording / "reading.npy"), np.load(recording / "time.npy")
    reading, times = CHANGES[name](reading.copy(), times.copy(), case.rng)
    for file, array in (("reading.npy", reading), ("time.npy", times)):
        np.save(recording / file, array, allow_pickle=True)
    correct(recording)
    return _judge(source, case.folder, name)


def _attack_odometry(case: Case) -> Verdict:
    change = list(ODOMETRY)[case.number % len(ODOMETRY)]
    source, recording = _record(case.folder)
    path = recording / "manifest.json"
    manifest = json.loads(path.read_text())
    name = change if change in manifest["odometry"] else case.rng.choice(list(manifest["odometry"]))
    manifest["odometry"][name] = ODOMETRY[change]
    manifest.pop("checksum", None)  # of the manifest itself; without it, it is believed
    path.write_text(json.dumps(manifest))
    return _judge(source, case.folder, f"{name} = {ODOMETRY[change]}")


def _record(folder: Path) -> tuple[str, Path]:
    """A scenario and its recording, to learn from."""
    source = write_scenario("landmarks", folder, **CHANGED)
    must_end(deepgps("collect", source, "--out", "run", cwd=folder))
    return source, folder / "run" / "recording"


def correct(recording: Path) -> None:
    """Let the manifest's checksums fit the files."""
    path = recording / "manifest.json"
    manifest = json.loads(path.read_text())
    for name in manifest["sha256"]:
        manifest["sha256"][name] = hashlib.sha256((recording / name).read_bytes()).hexdigest()
    manifest.pop("checksum", None)  # of the manifest itself; without it, it is believed
    path.write_text(json.dumps(manifest, indent=1) + "\n")


def _judge(source: str, folder: Path, name: str) -> Verdict:
    ended = deepgps("evaluate", source, "--out", "run", cwd=folder)
    detail = f"{name}: {ended.show()}"
    if ended.fell:
        return Verdict(ended.fell, False, detail)
    if ended.code:
        held = len(ended.complaints) == 1
        return Verdict("refused in a line" if held else f"{len(ended.complaints)} lines", held, detail)
    found = json.loads((folder / "run" / "metrics.json").read_text())["methods"]["deepgps"]["rms_m"]
    far = not found <= NEAR_M
    flagged = "said" if SAYS.search(ended.text) else "not said"
    return Verdict(f"{flagged}, RMS {'far off' if far else 'near'}", not far, f"RMS {found:.3f} m, {detail}")


def _ticks(change: Callable[[np.ndarray, random.Random], np.ndarray]) -> Change:
    """A change of the two columns of ticks."""

    def apply(reading: np.ndarray, times: np.ndarray, rng: random.Random) -> Readings:
        reading[:, 2:] = change(reading[:, 2:], rng)
        return reading, times

    return apply


def _at(rng: random.Random, array: np.ndarray) -> int:
    return rng.randrange(2, len(array) - 2)


def _jump(size: int) -> Change:
    def change(ticks: np.ndarray, rng: random.Random) -> np.ndarray:
        ticks[_at(rng, ticks) :, rng.choice([0, 1])] += rng.choice([-1, 1]) * size
        return ticks

    return _ticks(change)


def _spike(size: int) -> Change:
    def change(ticks: np.ndarray, rng: random.Random) -> np.ndarray:
        ticks[_at(rng, ticks), rng.choice([0, 1])] += rng.choice([-1, 1]) * size
        return ticks

    return _ticks(change)


def _wrap(bits: int) -> Change:
    def change(ticks: np.ndarray, rng: random.Random) -> np.ndarray:
        signed, offset = (
            rng.random() < 0.5,
            rng.randrange(2**bits) if bits < 32 else 2**31 - abs(int(ticks[len(ticks) // 2, 0])),
        )
        wrapped = (ticks + offset) % 2**bits
        return np.where(wrapped >= 2 ** (bits - 1), wrapped - 2**bits, wrapped) if signed else wrapped

    return _ticks(change)


def _rows(change: Callable[[np.ndarray, random.Random], np.ndarray]) -> Change:
    return lambda reading, times, rng: (change(reading, rng), times)


def _times(change: Callable[[np.ndarray, random.Random], np.ndarray]) -> Change:
    return lambda reading, times, rng: (reading, change(times, rng))


def _put(column: int, value: int) -> Change:
    def change(reading: np.ndarray, rng: random.Random) -> np.ndarray:
        reading[_at(rng, reading), column] = value
        return reading

    return _rows(change)


def _some_nan(times: np.ndarray, rng: random.Random) -> np.ndarray:
    times[_at(rng, times)] = rng.choice([float("nan"), float("inf"), -float("inf")])
    return times


def _one_back(times: np.ndarray, rng: random.Random) -> np.ndarray:
    times[_at(rng, times)] -= rng.uniform(1.0, 1e6)
    return times


def _shuffled(array: np.ndarray, rng: random.Random) -> np.ndarray:
    return array[np.random.default_rng(rng.randrange(2**32)).permutation(len(array))]


CHANGES: Mapping[str, Change] = {
    "nothing": lambda reading, times, rng: (reading, times),
    "a jump of 1e9 ticks": _jump(10**9),
    "a jump of 1e6 ticks": _jump(10**6),
    "a jump of 2^40 ticks": _jump(2**40),
    "one reading off by 1e9 ticks": _spike(10**9),
    "one reading off by 200,000 ticks": _spike(200_000),
    "16-bit counters": _wrap(16),
    "32-bit counters": _wrap(32),
    "near 2^63": _ticks(lambda ticks, rng: ticks + (2**63 - 1 - int(ticks.max()))),
    "beyond 2^63": _ticks(lambda ticks, rng: ticks + np.int64(2**62) + np.int64(2**62 - 1)),
    "all at the least of 64 bits": _ticks(lambda ticks, rng: np.full_like(ticks, -(2**63))),
    "readings shuffled": _rows(_shuffled),
    "ticks shuffled": _ticks(_shuffled),
    "all ticks zero": _ticks(lambda ticks, rng: np.zeros_like(ticks)),
    "one wheel does not turn": _ticks(lambda ticks, rng: ticks * np.array([1, 0])),
    "ticks times 1,000": _ticks(lambda ticks, rng: ticks * 1000),
    "readings doubled": _rows(lambda reading, rng: np.repeat(reading, 2, axis=0)),
    "half of the readings": _rows(lambda reading, rng: reading[: len(reading) // 2]),
    "no readings": _rows(lambda reading, rng: reading[:0]),
    "one reading": _rows(lambda reading, rng: reading[:1]),
    "three columns": _rows(lambda reading, rng: reading[:, :3]),
    "one dimension": _rows(lambda reading, rng: reading.ravel()),
    "floats with NaN": _rows(lambda reading, rng: np.where(reading % 7 == 3, np.nan, reading.astype(float))),
    "objects": _rows(lambda reading, rng: reading.astype(object)),
    "text": _rows(lambda reading, rng: reading.astype(str)),
    "32-bit integers": _rows(lambda reading, rng: reading.astype(np.int32)),
    "observation -1": _put(1, -1),
    "observation 1,000,000": _put(1, 10**6),
    "observation 2^62": _put(1, 2**62),
    "segment -5": _put(0, -5),
    "segment 2^62": _put(0, 2**62),
    "one segment": _rows(lambda reading, rng: reading * np.array([0, 1, 1, 1])),
    "time runs back once": _times(_one_back),
    "time backwards": _times(lambda times, rng: times[::-1]),
    "time shuffled": _times(_shuffled),
    "time not a number": _times(_some_nan),
    "all time not a number": _times(lambda times, rng: times * np.nan),
    "time does not advance": _times(lambda times, rng: times * 0),
    "one time too many": _times(lambda times, rng: np.append(times, times[-1] + 1)),
    "half of the times": _times(lambda times, rng: times[: len(times) // 2]),
    "times of 1e300": _times(lambda times, rng: times + 1e300),
}
ODOMETRY: Mapping[str, object] = {
    "ticks_per_rev": 0,
    "wheel_radius_m": -1.0,
    "track_m": float("nan"),
    "text": "many",
    "nothing": None,
    "list": [1, 2],
}
