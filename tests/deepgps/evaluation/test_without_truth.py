"""What is said of a run without truth: exact on made-up positions, and complete for a run on an imported log."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.commands.main import main
from deepgps.evaluation.without_truth import judge_segments, read_judged
from deepgps.reports.without_truth import describe, markdown, tabulate
from deepgps.robot_io.logs.importing import import_log
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.terminal.progress import ignore
from sim.recording.format import open_recording, open_truth
from tests.helpers.robot_log import CONFIG, make_notes, write_log

QUICK = ("--learn.train.steps", "20", "--learn.network.width", "16", "--learn.fold.restarts", "0")


def test_true_positions_agree_with_the_wheels_and_scaled_ones_tell_their_scale(small_recording: Path) -> None:
    recording, pose = open_recording(small_recording), open_truth(small_recording).pose
    exact = judge_segments(pose[:, :2], recording)
    assert exact["length_rms_m"] < 0.01 and exact["scale"] == pytest.approx(1.0, abs=0.01)
    lost = pose[:, :2].copy()
    lost[recording.reading[0, 1]] += 9.0
    accepted = np.arange(len(lost)) != recording.reading[0, 1]
    refused = judge_segments(lost, recording, accepted)
    assert refused["length_rms_m"] > 0.1 and refused["length_rms_accepted_m"] < 0.01
    larger = judge_segments(1.5 * pose[:, :2] + 3.0, recording)
    assert larger["scale"] == pytest.approx(1.5 * exact["scale"])
    assert larger["straight_rms_m"] == pytest.approx(1.5 * exact["straight_rms_m"], rel=1e-6)


def test_positions_beside_the_line_are_off_it(small_recording: Path) -> None:
    recording = open_recording(small_recording)
    rows = recording.reading[recording.reading[:, 0] == recording.reading[0, 0]]
    line = replace(recording, reading=rows, time=recording.time[: len(rows)])
    place = np.zeros((len(recording.observation), 2))
    place[rows[:, 1], 0] = np.arange(len(rows)) * 0.08
    assert judge_segments(place, line)["straight_rms_m"] == pytest.approx(0.0, abs=1e-12)
    place[rows[:, 1], 1] = 0.01 * (-1.0) ** np.arange(len(rows))
    assert judge_segments(place, line)["straight_rms_m"] == pytest.approx(0.01, rel=0.1)


@pytest.mark.slow
def test_a_run_on_a_log_without_poses_says_what_it_knows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_log(tmp_path / "log", make_notes("image/jpeg"), "mcap_lz4")
    config = RobotConfig.model_validate({**CONFIG, "drive": {"spacing_m": 0.05, "held_out": 0.4}})
    import_log(log, config, tmp_path / "mine", ignore)
    run = tmp_path / "run"
    main(["run", str(tmp_path / "mine"), "--methods", "deepgps_compass", "--out", str(run), *QUICK])
    said = capsys.readouterr().out
    assert "There is no ground truth, so no figure here is an error of a position." in said
    found = read_judged(run)
    assert found is not None and found["held_out"]["segments"] == 2
    values = found["methods"]["deepgps_compass"]["held_out"]
    assert {"length_rms_m", "scale", "straight_rms_m", "turn_rms_deg"} <= set(values)
    assert values["turns"] == 1 and (run / "run.rrd").stat().st_size > 10_000
    assert "| length, RMS [cm] |" in markdown(run).splitlines()[0]
    before = (run / "without_truth.json").read_bytes()
    main(["run", str(run)])
    assert (run / "without_truth.json").read_bytes() == before


def test_without_held_out_segments_the_table_says_so() -> None:
    segments = {"length_rms_m": 0.012, "length_median_m": 0.01, "scale": 1.0, "straight_rms_m": None}
    method = {"segments": segments, "fold": {"found": True}}
    found = {"samples": 90, "segments": 8, "distance_driven_m": 9.6, "methods": {"deepgps": method}}
    _, (row,) = tabulate(found)
    assert row == ("DeepGPS", "1.2", "1.0", "1.0000")
    said = " ".join(describe(found))
    assert "Wheels" not in said
    assert "Wheels: nothing is wrong" in " ".join(describe({**found, "wheels": []}))
    assert "Wheels: The left one sticks." in describe({**found, "wheels": ["The left one sticks."]})
    assert "none are held out" in said and "DeepGPS: its map looks folded." in said
