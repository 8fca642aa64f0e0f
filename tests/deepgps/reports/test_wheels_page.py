"""What the encoders told, held against drives whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest

from deepgps.evaluation.segment_errors import measure_segments, reckon_path
from deepgps.reports.wheels_page import describe_encoders, draw_segments, list_faults
from sim.recording.format import Recording, Truth, open_recording, open_truth
from tests.helpers.synthetic_run import TICKS_PER_REV, WHEEL_RADIUS_M, write_synthetic_run

TICK_M = 2 * np.pi * WHEEL_RADIUS_M / TICKS_PER_REV


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Truth]:
    folder = write_synthetic_run(tmp_path_factory.mktemp("run"), samples=300, spacing_m=1.0) / "recording"
    return open_recording(folder), open_truth(folder)


def scale_ticks(recording: Recording, factor: float) -> Recording:
    reading = recording.reading.copy()
    reading[:, 2:] = np.rint(reading[:, 2:] * factor)
    return replace(recording, reading=reading)


def set_encoders(recording: Recording, **faults: object) -> Recording:
    settings = {**recording.manifest.settings, "encoder": faults}
    return replace(recording, manifest=recording.manifest.model_copy(update={"settings": settings}))


def test_distances_told_too_long_are_wrong_in_proportion(drive: tuple[Recording, Truth]) -> None:
    recording, truth = drive
    for factor in (0.9, 1.02):
        scaled = scale_ticks(recording, factor)
        length, error = measure_segments(scaled, truth.pose)
        np.testing.assert_allclose(error, (factor - 1) * length, atol=3 * TICK_M)
        said = " ".join(describe_encoders(scaled, truth.pose, np.zeros(len(recording.reading))).split())
        assert f"| encoder / true distance | {factor:.3f}" in said


def test_a_sound_reckoned_path_is_the_true_one(drive: tuple[Recording, Truth]) -> None:
    recording, truth = drive
    true = truth.pose[recording.reading[:, 1], :2]
    off = np.linalg.norm(reckon_path(recording, truth.pose) - true, axis=1)
    assert off[0] == 0
    assert off.max() < 0.15  # 4096 ticks leave 0.02 degrees to each turn
    drifted = np.linalg.norm(reckon_path(scale_ticks(recording, 1.05), truth.pose) - true, axis=1)
    assert drifted.max() > 10 * off.max()


def test_a_path_without_turns_is_as_wrong_as_its_ticks(drive: tuple[Recording, Truth]) -> None:
    recording, truth = drive
    first = replace(recording, reading=recording.reading[recording.reading[:, 0] == 0])
    true = truth.pose[first.reading[:, 1], :2]
    off = np.linalg.norm(reckon_path(scale_ticks(first, 2.0), truth.pose) - true, axis=1)
    np.testing.assert_allclose(off, np.linalg.norm(true - true[0], axis=1), atol=0.01)


def test_faults_that_were_set_are_listed_and_no_others(drive: tuple[Recording, Truth]) -> None:
    recording, _ = drive
    assert list_faults(recording) == "No faults are set: 4096 ticks per revolution, all of them correct."
    faulty = list_faults(set_encoders(recording, step_noise=0.1, dropout=0.0, slip_per_m=0.02, ticks_per_rev=4096))
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in faulty.splitlines()[2:]]
    assert rows == [["encoder.step_noise", "**0.1**", "0.0"], ["encoder.slip_per_m", "**0.02**", "0.0"]]


def test_the_picture_shows_every_segment() -> None:
    rng = np.random.default_rng(0)
    length = rng.uniform(0.2, 4.0, 200)
    error = 0.02 * length * rng.standard_normal(200)
    cloud, counts = draw_segments(length, error).axes
    shown = np.asarray(cloud.collections[0].get_offsets())
    np.testing.assert_allclose(shown, np.stack([length, 1000 * error], axis=1))
    assert sum(bar.get_width() for bar in counts.patches) == 200  # pyright: ignore[reportAttributeAccessIssue]
    assert draw_segments(length[:1], error[:1]).axes, "one short segment is enough"
