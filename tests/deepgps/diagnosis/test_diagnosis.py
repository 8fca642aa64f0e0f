"""Diagnosis of recordings with known faults: the fault is named, the interval holds, and the truth is not needed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.diagnosis.diagnosis import Diagnosis, Estimate, apply_diagnosis, diagnose
from deepgps.diagnosis.findings import correct, find_faults
from deepgps.diagnosis.store import FILE, diagnose_once, read_diagnosis, take_diagnosed
from deepgps.reports.wheels_page import NO_FAULT_NOTE, TOO_SHORT_NOTE, UNKNOWN_SCALE_NOTE, write_markdown
from sim.errors import InputError
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import lose_turns
from sim.rng import stream
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import EncoderSettings


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


def derive(recording: Recording, **faults: float) -> Recording:
    """The recording as encoders with faults measure it, without files; their data sheet says that there are none."""
    settings, truth = EncoderSettings.model_validate(faults), open_truth(recording.folder)
    old = recording.manifest.odometry
    ticks, arrived = read_encoders(truth.wheel_angle, old["wheel_radius_m"], settings, stream(5, "encoder"))
    known = describe_odometry(settings, old["wheel_radius_m"], old["track_m"]) | {"step_noise": 0.0, "slip_per_m": 0.0}
    assert recording.turns is not None
    return replace(
        recording,
        reading=np.column_stack([truth.reading, ticks])[arrived].astype(np.int64),
        time=recording.time[arrived],
        turns=lose_turns(recording.turns, truth.reading[:, 0], arrived),
        manifest=recording.manifest.model_copy(update={"odometry": known}),
    )


def names(diagnosis: Diagnosis) -> list[str]:
    return [finding.fault for finding in find_faults(diagnosis)]


def test_wheels_without_faults_raise_no_alarm(recording: Recording):
    diagnosis = diagnose(recording)
    assert names(diagnosis) == []
    assert NO_FAULT_NOTE in write_markdown(diagnosis)
    assert UNKNOWN_SCALE_NOTE in write_markdown(diagnosis)
    nothing = Estimate(np.nan, np.nan, np.nan)
    unknown = write_markdown(replace(diagnosis, track_m=nothing))
    assert TOO_SHORT_NOTE in unknown and NO_FAULT_NOTE not in unknown


@pytest.mark.parametrize(
    ("faults", "fault", "quantity", "truth"),
    [
        ({"radius_error_left": 0.05}, "radius", "reading_ratio", 1 / 1.05),
        ({"radius_error_right": -0.05}, "radius", "reading_ratio", 0.95),
        ({"slip_per_m": 0.02}, "slip", "slip_per_m", 0.02),
        ({"step_noise": 0.1}, "step_noise", "step_noise", 0.1),
        ({"ticks_per_rev": 16}, "ticks", "tick_m", 2 * np.pi * 0.03299 / 16),
        ({"dropout": 0.3}, "dropout", "dropout", 0.3),
        ({"stuck_fraction": 0.2}, "stuck", "stuck_fraction", 0.2),
        ({"track_error": -0.08}, "track", "track_m", 0.16),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_fault_is_named_alone_and_its_size_is_told(
    recording: Recording, faults: dict, fault: str, quantity: str, truth: float
):
    diagnosis = diagnose(derive(recording, **faults))
    assert names(diagnosis) == [fault]
    estimate = diagnosis.quantities[quantity]
    half = max((estimate.high - estimate.low) / 2, 1e-3 * truth)  # one draw may lie just outside
    assert estimate.low - half <= truth <= estimate.high + half
    assert abs(estimate.value - truth) < 0.2 * truth


def test_one_wheel_explains_turns_too_so_the_track_width_stays(recording: Recording):
    fix = correct(diagnose(derive(recording, radius_error_left=0.1)))
    assert (fix.readings, fix.exact, fix.track, fix.right) == ("left", True, 1.0, 1.0)
    assert abs(fix.left - 1 / 1.1) < 2e-3


def test_radii_that_are_wrong_alike_change_turns_as_the_track_width_does(recording: Recording):
    alike = diagnose(derive(recording, radius_error_left=0.05, radius_error_right=0.05))
    track = diagnose(derive(recording, track_error=1 / 1.05 - 1))
    assert names(alike) == names(track) == ["track"]
    assert alike.turn_scale.value == pytest.approx(track.turn_scale.value, rel=1e-3)
    assert "or both radii are too large" in write_markdown(alike)


def test_set_as_told_the_wheels_are_right(recording: Recording):
    wrong = derive(recording, radius_error_left=0.05, track_error=0.1)
    fix, odometry = correct(diagnose(wrong)), wrong.manifest.odometry
    assert not fix.exact
    turned = np.diff(wrong.reading[:, 2:], axis=0) * [fix.left, fix.right]
    radius_m, track_m = odometry["wheel_radius_m"], odometry["track_m"] * fix.track
    yaw = (turned[:, 1] - turned[:, 0]) * 2 * np.pi * radius_m / odometry["ticks_per_rev"] / track_m
    way, yaw_true = np.append(0.0, np.cumsum(yaw)), open_truth(recording.folder).pose[wrong.reading[:, 1], 2]
    assert wrong.turns is not None
    after = wrong.turns.after[(wrong.turns.image >= 0) & (wrong.turns.after + 1 < len(yaw_true))]
    turned_too_far = (way[after + 1] - way[after - 1]) - (yaw_true[after + 1] - yaw_true[after - 1])
    off = wrap(turned_too_far)  # a turning place has one observation, of before the turn
    assert len(off) > 20
    assert np.abs(off).max() < np.radians(1.0)


def test_methods_take_what_was_diagnosed_from_a_file_that_is_made_once(recording: Recording, tmp_path: Path):
    noisy = derive(recording, step_noise=0.02, track_error=0.1)
    told, said = take_diagnosed(noisy, tmp_path)
    stored = read_diagnosis(tmp_path, noisy)
    assert stored is not None
    assert stored == diagnose(noisy) == diagnose_once(noisy, tmp_path)
    assert said["diagnosed"]["step_noise"] == told.manifest.odometry["step_noise"] == stored.step_noise.value
    assert abs(told.manifest.odometry["track_m"] / recording.manifest.odometry["track_m"] - 1) < 0.01
    assert read_diagnosis(tmp_path, recording) is None, "it is of another recording"
    (tmp_path / FILE).write_text("{")
    assert diagnose_once(noisy, tmp_path) == stored


def test_without_turns_the_data_sheet_stands(recording: Recording, tmp_path: Path):
    old = replace(derive(recording, step_noise=0.2), turns=None, turn_observation=None)
    assert take_diagnosed(old, tmp_path) == (old, {"diagnosed": None})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="no images after turns"):
        diagnose(old)


def test_too_few_turns_leave_the_track_width_unknown(recording: Recording):
    short = replace(recording, reading=recording.reading[:40], time=recording.time[:40])
    assert recording.turns is not None
    kept = recording.turns.after < 40
    turns = replace(recording.turns, **{name: value[kept][:3] for name, value in vars(recording.turns).items()})
    diagnosis = diagnose(replace(short, turns=turns))
    assert not diagnosis.track_m.known
    assert "drive longer" in write_markdown(diagnosis)
    odometry = apply_diagnosis(short, diagnosis).manifest.odometry
    assert odometry["track_m"] == recording.manifest.odometry["track_m"]
