"""Real wheels: what runs were made with is found again, whatever the frame, and the tracker's noise is separated."""

import os
from pathlib import Path

import numpy as np
import pytest

from deepgps.commands.main import main
from deepgps.diagnosis.findings import CERTAINTY_HALF_WIDTHS
from deepgps.evaluation.wheels import SPACING_M, WheelRun, Wheels, measure_wheels, read_run, reckon
from docs.wheels_picture import draw_wheels
from sim.errors import InputError
from sim.rng import stream
from sim.sensors.encoder import disturb
from sim.settings import EncoderSettings

RADIUS_M, TRACK_M, TICKS, TRACKER_M, TRACKER_RAD = 0.033, 0.16, 4096, 2e-4, 1e-3
FAULTS = EncoderSettings(radius_error_left=0.01, radius_error_right=-0.006, slip_per_m=0.004, step_noise=0.02)
ASSUMED = (RADIUS_M, RADIUS_M, 1.01 * TRACK_M)
STEP_M = 0.01  # Way of the wheels from row to row [m]
ORDER = "time_s,x_m,y_m,yaw_rad,right_increment,left_increment"
OPTIODOM = Path(os.environ.get("OPTIODOM", "optiodom"))  # github.com/sousarbarb/optiodom, its folder data/diff
OPTIODOM_DRIVE, OPTIODOM_TICKS = (0.042, 0.042, 0.2), 43.7 * 64


def drive(seed: int, faults: EncoderSettings, tracker: float = 1.0) -> tuple[np.ndarray, WheelRun]:
    """Times and a run at 20 Hz: rest, straight pieces, curves and turns in place in random order, and rest."""
    rng, steps = stream(seed, "drive"), []
    for bend in rng.permutation([0.0, 0.0, 0.0, 0.5, -0.5, 1.0, -1.0]):
        turn, forward, count = (2.0 * bend / TRACK_M, 0.0, 25) if abs(bend) == 1.0 else (4.0 * bend, 1.0, 60)
        steps += [(forward - turn * TRACK_M / 2.0, forward + turn * TRACK_M / 2.0)] * count
    steps = np.pad(STEP_M * np.array(steps), ((20, 20), (0, 0)))
    true = WheelRun(np.cumsum(steps, axis=0) / RADIUS_M, np.empty(0), np.empty(0))
    heading, place, _ = reckon(true, (RADIUS_M, RADIUS_M, TRACK_M))
    finer = faults.model_copy(update={"step_noise": faults.step_noise * (SPACING_M / STEP_M) ** 0.5})  # a gap has eight
    angle = np.floor(disturb(true.angle, finer, RADIUS_M, rng)[0] * TICKS / (2 * np.pi)) / TICKS * (2 * np.pi)
    noise = tracker * rng.standard_normal((3, len(place)))
    place = place + TRACKER_M * (noise[0] + 1j * noise[1])
    return np.arange(len(place)) / 20, WheelRun(angle, place, heading + TRACKER_RAD * noise[2])


def measure(runs: list[WheelRun]) -> Wheels:
    return measure_wheels(runs, [str(number) for number in range(len(runs))], ASSUMED)


@pytest.fixture(scope="module")
def runs() -> list[WheelRun]:
    return [drive(seed, FAULTS)[1] for seed in range(16)]


@pytest.fixture(scope="module")
def measured(runs: list[WheelRun]) -> Wheels:
    return measure(runs)


def test_the_settings_that_runs_were_made_with_are_found_within_their_intervals(measured: Wheels):
    left, right = (RADIUS_M / (1.0 + error) for error in (FAULTS.radius_error_left, FAULTS.radius_error_right))
    noise = {"step_noise": FAULTS.step_noise, "slip_per_m": FAULTS.slip_per_m, "tracker_m": 2**0.5 * TRACKER_M}
    for name, value in {"left_m": left, "right_m": right, "track_m": TRACK_M, **noise}.items():
        found = measured.intervals[name]
        assert abs(found.value - value) < CERTAINTY_HALF_WIDTHS * (found.high - found.value), name
        assert name == "tracker_m" or found.high < (1.01 if value in (left, right, TRACK_M) else 1.7) * value, name
    settings = measured.model.make_settings(ASSUMED, TICKS)
    for name, value in {**FAULTS.model_dump(exclude_defaults=True), "track_error": 0.01}.items():
        assert getattr(settings, name) == pytest.approx(value, abs=0.005), name
    before, after = np.median(list(measured.ends_m.values()), axis=0)
    assert after < 0.7 * before and len(draw_wheels(measured).axes) == 3


def test_a_rigid_motion_of_the_true_poses_changes_nothing(runs: list[WheelRun], measured: Wheels):
    moved = [run._replace(place=run.place * np.exp(2j) + 3.0 - 1j, yaw=run.yaw + 2.0) for run in runs]
    np.testing.assert_allclose(measure(moved).model, measured.model, rtol=1e-6)


def test_noise_of_the_tracker_alone_is_none_of_the_wheels():
    alone = measure([drive(seed, EncoderSettings())[1] for seed in range(16)])
    assert alone.model.step_noise < 0.002 and alone.model.slip_per_m < 5e-4
    assert alone.model.tracker_m == pytest.approx(2**0.5 * TRACKER_M, rel=0.1)
    assert alone.model.tracker_rad == pytest.approx(2**0.5 * TRACKER_RAD, rel=0.1)


def write(path: Path, seed: int = 0, lag_s: float = 0.0, head: str = "") -> Path:
    time, run = drive(seed, FAULTS, tracker=0.0)
    ticks = np.rint(run.angle * TICKS / (2 * np.pi)).astype(int)
    place = np.interp(time + lag_s, time, run.place.real), np.interp(time + lag_s, time, run.place.imag)
    yaw = (np.interp(time + lag_s, time, run.yaw) + np.pi) % (2 * np.pi) - np.pi
    steps = np.diff(ticks, axis=0, prepend=ticks[:1]) if "ticks" not in head else ticks + 1_000_000
    known = (time, *place, yaw, steps[:, 1], steps[:, 0])
    columns: dict[str, np.ndarray] = dict(zip(ORDER.split(","), known, strict=True))
    columns |= {"left_ticks": steps[:, 0], "right_ticks": steps[:, 1], "light": time * 0.0}
    rows = zip(*(columns[name].tolist() for name in (head or ORDER).split(",")), strict=True)
    lines = [*([head] if head else []), *(",".join(map(repr, row)) for row in rows), ""]
    path.write_text("\n".join(lines), encoding="utf-8-sig")
    return path


def test_a_table_is_read_by_its_header_or_in_the_order_of_optiodom(tmp_path: Path):
    plain = read_run(write(tmp_path / "a.csv"), TICKS, ASSUMED)
    head = "light,yaw_rad,left_ticks,time_s,right_ticks,y_m,x_m"
    named = read_run(write(tmp_path / "b.csv", head=head), TICKS, ASSUMED)
    for one, other in zip(plain, named, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


@pytest.mark.parametrize("lag_s", [-0.31, 0.0, 0.12])
def test_a_delay_between_ticks_and_poses_is_taken_off(tmp_path: Path, lag_s: float):
    found = read_run(write(tmp_path / "a.csv", lag_s=lag_s), TICKS, ASSUMED)
    assert np.abs(found.place - drive(0, FAULTS, tracker=0.0)[1].place)[20:-20].max() < 0.005  # of 24 mm or more


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (0, "time_s,x_m,y_m,yaw,left_ticks,right_ticks", "no column yaw_rad"),
        (0, "0.0,0.0,0.0,0.0,0", "header or 6 columns"),
        (3, "0.15,0.0,nan,0.0,0,0", "line 4: a value is no number"),
        (3, "0.15,0.0,,0.0,0,0", "could not convert"),
        (3, "0.05,0.0,0.0,0.0,0,0", "line 4: time_s must rise"),
        (3, "0.15,0.0,0.0,0.0,0.5,0", "line 4: left_increment and right_increment must be whole"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path: Path, line: int, text: str, message: str):
    path = write(tmp_path / "a.csv")
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    path.write_text("\n".join([*lines[:line], text, *lines[line + 1 :]]) + "\n")
    with pytest.raises(InputError, match=message) as raised:
        read_run(path, TICKS, ASSUMED)
    assert str(path) in str(raised.value) and "\n" not in str(raised.value)


def test_too_little_and_exchanged_wheels_are_refused(runs: list[WheelRun]):
    for wrong, message in (
        (runs[:2], "too few runs: 2"),
        ([WheelRun(*(part[:50] for part in run)) for run in runs], "too few m: "),
        ([run._replace(angle=run.angle[:, ::-1]) for run in runs], "sides right"),
        ([run._replace(place=1000 * run.place) for run in runs], "positions in m"),
    ):
        with pytest.raises(InputError, match=message):
            measure(wrong)


def test_the_command_prints_intervals_and_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    files = [str(write(tmp_path / f"{seed % 2}-{seed}.csv", seed)) for seed in range(4)]
    options = ["--wheel-diameter-m", "0.066", "--track-m", "0.1616", "--ticks-per-rev", str(TICKS), "--same-day", "1"]
    main(["wheels", *files, *options])
    said = capsys.readouterr().out
    assert [word for word in ("track width", "Gaps of 8 cm", "2 parts", "\nencoder:") if word not in said] == []


@pytest.mark.slow
@pytest.mark.skipif(not OPTIODOM.is_dir(), reason="OPTIODOM names no folder with the runs of a real robot")
def test_a_real_robots_other_days_are_told():
    files = sorted(OPTIODOM.rglob("*_run-??.csv"))
    runs, days = [read_run(file, OPTIODOM_TICKS, OPTIODOM_DRIVE) for file in files], [file.name[:8] for file in files]
    ends = measure_wheels(runs, days, OPTIODOM_DRIVE).ends_m
    ratios = [after / before for day, (before, after) in ends.items() if days.count(day) > 20]
    assert len(ratios) == 3 and np.mean(ratios) < 0.6
