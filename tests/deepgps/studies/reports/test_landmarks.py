"""The study of landmarks: its report from made-up rows, and one of its runs for real, small, to its last file."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.config.scenario import load_scenario
from deepgps.run import run
from deepgps.studies.catalog import REPORTS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.landmarks import PAPER, measure, report
from deepgps.studies.reports.report import write_report
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from deepgps.viewer.read import read_error_field
from deepgps.viewer.run.recording import RECORDING

SMALL = {
    "landmarks.count": 40,
    "landmarks.segments": 25,
    "landmarks.reach_m": 1.2,
    "drive.spacing_m": 0.05,
    "grid.spacing_m": 0.25,
    "learn.train.steps": 20,
    "learn.train.segments": 4,
    "learn.network.width": 16,
    "learn.explicit.readings": 200,
    "learn.explicit.evaluations": 20,
    "learn.fold.restarts": 0,
}


def make_rows(rms: dict[tuple[str, str], tuple[float, ...]]) -> list[Row]:
    """A row for each seed of each kind of observation and method."""
    return [
        {"landmarks.reach_m": None if kind == "complete" else 0.6, "method": method, "seed": seed, "rms_m": value}
        | {"median_m": value / 2, "max_m": 10 * value, "train_s": 10.0 + seed}
        for (kind, method), values in rms.items()
        for seed, value in enumerate(values)
    ]


ROWS = make_rows(
    {
        ("complete", "deepgps"): (0.0005, 0.0009),
        ("complete", "explicit_mds"): (1e-8, 3e-8),
        ("incomplete", "deepgps"): (0.002, 0.004),
    }
)


def cells(lines: list[str], *first: str) -> list[str]:
    """The cells of the one line that begins with these."""
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    (line,) = [line for line in found if tuple(line[: len(first)]) == first]
    return line


def test_the_training_time_is_that_of_deepgps_alone():
    slow = [{**row, "train_s": 900.0} if row["method"] != "deepgps" else row for row in ROWS]
    assert measure(slow)["train_s"].value == 10.5


def test_every_method_stands_beside_the_papers_figure():
    lines = report(ROWS, ["landmarks.reach_m", "seed"])[0].splitlines()
    ours = ["2", "0.7", "0.35", "7", "0.9", "10"]
    assert cells(lines, "complete", "DeepGPS")[2:] == [*ours, "4", "4", "21"]
    assert cells(lines, "complete", "Explicit, from MDS")[3:5] == ["2e-05", "1e-05"]
    assert cells(lines, "complete", "Explicit, from MDS")[-3:] == ["-", "-", "-"]
    assert cells(lines, "incomplete", "DeepGPS")[-3:] == ["9", "7", "111"]


def test_targets_are_judged_by_the_mean_over_the_seeds():
    study = load_study("landmarks", tiny=False)
    plan, *_ = plan_runs(study)
    rows = [{**row, "run": plan.run, "failure": None} for row in ROWS]
    lines = write_report(study, [plan], {}, rows).splitlines()
    assert cells(lines, "RMS, complete, DeepGPS")[1:] == ["0.70 mm", "-", "0.90 mm", "<= 0.80 mm", "met", "4.00 mm"]
    assert cells(lines, "RMS, incomplete, DeepGPS")[4:] == ["<= 2.50 mm", "missed", "9.00 mm"]


def test_figures_have_the_names_that_a_study_may_use_and_the_paper_stands_once():
    assert set(measure(ROWS)) <= set(REPORTS["landmarks"].targets)
    paper = load_study("landmarks", tiny=False).paper
    assert paper == {f"{method}_{kind}": figures[0] for (kind, method), figures in PAPER.items()}


def test_the_study_is_the_papers_experiment():
    plans = plan_runs(load_study("landmarks", tiny=False))
    assert {plan.scenario.landmarks.reach_m for plan in plans} == {None, 0.6}
    for plan in plans:
        landmarks = plan.scenario.landmarks
        assert (plan.scenario.world, landmarks.count, landmarks.segments) == ("landmarks", 128, 128)
        assert plan.scenario.drive.spacing_m == 0.02
        assert plan.scenario.encoder.step_noise == 0.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("landmarks") / "run"
    methods = ["deepgps", "posenet", "dead_reckoned_labels", "knn", "explicit", "explicit_mds"]
    run(load_scenario("landmarks", {**SMALL, "methods": methods}), folder, fresh=False, progress=ignore)
    return folder


def test_every_method_runs_to_the_viewer(folder: Path):
    with np.load(folder / "error_field.npz") as field:
        for method in ("deepgps", "posenet", "dead_reckoned_labels", "knn", "explicit", "explicit_mds"):
            shown = read_error_field(folder / RECORDING, method)
            assert np.allclose(shown.predicted, field[method][:, 0], atol=1e-5)
        assert np.abs(field["explicit_mds"][:, 0] - field["truth"]).max() < 1e-3
    assert (folder / "figures" / "error_fields.png").is_file()
