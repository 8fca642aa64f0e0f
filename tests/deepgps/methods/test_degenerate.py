"""Recordings that nobody would make on purpose: every method, and evaluation, ends with a result or with one line."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from deepgps.config.scenario import Scenario
from deepgps.evaluation.evaluate import evaluate
from deepgps.methods.fit import fit_method
from deepgps.terminal.progress import ignore
from sim.errors import InputError, WorkError
from sim.files.checksums import write_array
from sim.recording.format import finish_recording, open_recording
from tests.helpers.synthetic_run import make_images
from tests.helpers.toy import ODOMETRY, make_toy

Arrays = dict[str, np.ndarray]
LEARN = {
    "network": {"width": 16, "layers": 1},
    "features": {"rings": 4, "principal": 16, "components": 8, "frequencies": 4},
    "train": {"steps": 2, "segments": 4, "samples": 4},
    "fold": {"restarts": 0},
}
METHODS_OF = {
    "room": ("deepgps_compass", "deepgps", "posenet", "dead_reckoned_labels", "knn"),
    "obstacles": ("deepgps", "pca_knn"),
    "landmarks": ("explicit", "explicit_mds"),
}
ALIKE_MESSAGE = "all 74 observations look alike"


def keep_readings(arrays: Arrays, kept: np.ndarray) -> None:
    for name in ("reading.npy", "time.npy"):
        arrays[name] = arrays[name][kept]


def stand_still(arrays: Arrays) -> None:
    arrays["reading.npy"][:, 2:] = 0


def stop_a_wheel(arrays: Arrays) -> None:
    arrays["reading.npy"][:, 2] = 0


def drive_one_segment(arrays: Arrays) -> None:
    keep_readings(arrays, arrays["reading.npy"][:, 0] == np.bincount(arrays["reading.npy"][:, 0]).argmax())


def read_twice(arrays: Arrays) -> None:
    keep_readings(arrays, np.arange(2))


def read_each_segment_once(arrays: Arrays) -> None:
    arrays["reading.npy"][:, 0] = np.arange(len(arrays["reading.npy"]))


def see_nothing(arrays: Arrays) -> None:
    arrays["observations/landmarks.npy"][:] = 0


def see_the_same(arrays: Arrays) -> None:
    arrays["observations/landmarks.npy"][:] = arrays["observations/landmarks.npy"][0]


def see_nothing_in_deployment(arrays: Arrays) -> None:
    arrays["test/landmarks.npy"][:] = 0


def see_nothing_half_of_the_time(arrays: Arrays) -> None:
    arrays["observations/landmarks.npy"][::2] = 0


def try_nowhere(arrays: Arrays) -> None:
    arrays["test/landmarks.npy"] = arrays["test/landmarks.npy"][:0]
    arrays["truth/test_pose.npy"] = arrays["truth/test_pose.npy"][:0]


def see_two(arrays: Arrays) -> None:
    keep_readings(arrays, arrays["reading.npy"][:, 1] < 2)
    for name in ("observations/landmarks.npy", "truth/pose.npy"):
        arrays[name] = arrays[name][:2]


def see(name: str, number: float) -> Callable[[Arrays], None]:
    def spoil(arrays: Arrays) -> None:
        arrays[name] = arrays[name].astype(np.float32)
        arrays[name][-1].flat[0] = number

    return spoil


def write(folder: Path, world: str, spoil: Callable[[Arrays], None], odometry: dict | None = None) -> None:
    """Write a recording of a short drive that sees images, scans or ways to landmarks, spoiled."""
    make_toy(folder, samples=60)
    names = ("observations/landmarks.npy", "reading.npy", "time.npy", "test/landmarks.npy", "truth/pose.npy")
    arrays = {name: np.load(folder / name) for name in (*names, "truth/test_pose.npy")}
    if world == "room":
        arrays["observations/landmarks.npy"] = make_images(arrays["truth/pose.npy"], 4, 16)
        arrays["test/landmarks.npy"] = make_images(arrays["truth/test_pose.npy"], 4, 16)
    elif world == "obstacles":
        for name in ("observations/landmarks.npy", "test/landmarks.npy"):
            arrays[name] = arrays[name][..., None, :]
    spoil(arrays)
    if world == "room":
        arrays |= turn(arrays)
    for name, array in arrays.items():
        write_array(folder / name, array)
    kind = {"room": "polar_image", "obstacles": "scan", "landmarks": "vector"}[world]
    manifest = {"sensors": {"landmarks": kind}, "segments": 1, "distance_driven_m": 1.0}
    finish_recording(folder, {"odometry": {**ODOMETRY, **(odometry or {})}, **manifest})


def turn(arrays: Arrays) -> Arrays:
    """What a robot that turns in place between all its segments, and sees nothing change, stores of it."""
    reading = np.nan_to_num(arrays["reading.npy"], posinf=0, neginf=0).astype(np.int64)
    seen = arrays["observations/landmarks.npy"]
    after = np.flatnonzero(np.diff(arrays["reading.npy"][:, 0])) + 1
    before = reading[after - 1, 1].clip(0, len(seen) - 1)
    table = np.column_stack([before, np.arange(len(after)), after, np.zeros_like(after)])
    return {"turns.npy": table, "observations/landmarks_turn.npy": seen[before]}


def learn(run: Path, world: str, method: str) -> str:
    """Train and measure; what went wrong in words, or nothing."""
    scenario = Scenario.model_validate({"world": world, "methods": [method], "learn": LEARN})
    try:
        fit_method(method, open_recording(run / "recording"), scenario.learn, 0, run / method, ignore)
        metrics = evaluate(run, scenario)
    except (InputError, WorkError) as error:
        return str(error)
    assert json.dumps(metrics, allow_nan=False)
    assert np.isfinite(metrics["methods"][method]["rms_m"])
    return ""


CASES = [
    (stand_still, "no wheel turned on any segment"),
    (stop_a_wheel, ""),
    (drive_one_segment, ""),
    (read_twice, ""),
    (read_each_segment_once, "no segment has two readings"),
    (see_nothing, ALIKE_MESSAGE),
    (see_the_same, ALIKE_MESSAGE),
    (see_nothing_in_deployment, ""),
    (see_nothing_half_of_the_time, ""),
    (see_two, ""),
    (see("observations/landmarks.npy", np.nan), "observations/landmarks.npy: 1 of 74 observations hold NaN"),
    (see("observations/landmarks.npy", 1e30), "observations/landmarks.npy: 1 of 74 observations hold NaN, infinity"),
    (see("test/landmarks.npy", np.inf), "test/landmarks.npy: 1 of 150 observations hold NaN, infinity"),
    (try_nowhere, "test/landmarks.npy holds no observation"),
]
FOR_ALL = (stand_still, read_twice, see_two)
"""The cases that the quick tests try on every method; the others they try on two."""


def find_slow(world: str, method: str, spoil: Callable[[Arrays], None]) -> list[pytest.MarkDecorator]:
    quick = spoil in FOR_ALL or (world == "room" and method in ("deepgps", "knn"))
    return [] if quick else [pytest.mark.slow]


@pytest.mark.parametrize(
    ("world", "method", "spoil", "says"),
    [
        pytest.param(world, method, spoil, says, marks=find_slow(world, method, spoil))
        for world, methods in METHODS_OF.items()
        for method in methods
        for spoil, says in CASES
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_every_method_ends_with_a_result_or_one_line(
    world: str, method: str, spoil: Callable[[Arrays], None], says: str, tmp_path: Path
):
    write(tmp_path / "recording", world, spoil)
    said = learn(tmp_path, world, method)
    if "look alike" in says and method in ("explicit", "explicit_mds"):
        return  # these use no features: they end with some position, or say what they lack
    if said.startswith("some landmarks were never seen together"):
        return  # which is so where half of what is seen is nothing
    assert says in said if says else not said


def test_odometry_constants_that_cannot_be_are_named(tmp_path: Path):
    constants = {"ticks_per_rev": 0, "wheel_radius_m": 1e308, "track_m": 0.0, "step_noise": -1.0}
    for name, value in (*constants.items(), ("ticks_per_rev", "4096")):
        run = tmp_path / f"{name}{value}"
        write(run / "recording", "landmarks", lambda arrays: None, {name: value})
        assert f"manifest: odometry.{name} must be a number from" in learn(run, "landmarks", "explicit")


def test_a_counter_that_jumps_is_refused_by_name(tmp_path: Path):
    def jump(arrays: Arrays) -> None:
        arrays["reading.npy"][20, 2:] += 10**9

    write(tmp_path / "recording", "landmarks", jump)
    assert "before reading 20" in learn(tmp_path, "landmarks", "explicit")
