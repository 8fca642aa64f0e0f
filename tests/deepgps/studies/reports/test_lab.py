"""The report of the laboratory, from made-up rows, and its study for real, tiny, to its last file."""

import json
from pathlib import Path

import numpy as np
import pytest

from deepgps.config.scenario import load_scenario
from deepgps.evaluation.measure import evaluate
from deepgps.methods.train import train
from deepgps.run import show
from deepgps.runs.collect import make_recording
from deepgps.studies.catalog import REPORTS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.lab import PAPER, add, draw_places, measure, report
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from deepgps.viewer.read import open_rrd
from deepgps.viewer.run.recording import RECORDING
from sim.errors import InputError

ROWS = [
    {"seed": seed, "method": method, "rms_m": 0.06 + 0.02 * seed, "median_m": 0.03, "max_m": 0.2, "train_s": 40.0}
    | {"label_rms_m": 0.04 + 0.02 * seed, "label_median_m": 0.02, "label_max_m": 0.1}
    | {"unlabelled": 200, "test_unlabelled": 30, "labels_rms_m": 0.005, "labels_max_m": 0.07}
    for seed in (0, 1)
    for method in ("deepgps", "posenet")
]


def cells(lines: list[str], *first: str) -> list[str]:
    """The cells of the one line that begins with these."""
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    (line,) = [line for line in found if tuple(line[: len(first)]) == first]
    return line


def test_both_truths_stand_beside_the_papers():
    lines = report(ROWS, ["seed"])[0].splitlines()
    assert cells(lines, "1", "DeepGPS")[2:] == ["6.0", "2.0", "10.0", "8.0", "3.0", "20.0", "200 + 30", "0.5", "40"]
    assert cells(lines, "mean ± std", "PoseNet")[2:6] == ["5.0 ± 1.0", "2.0 ± 0.0", "10.0 ± 0.0", "7.0 ± 1.0"]
    assert cells(lines, "paper", "DeepGPS")[2:5] == ["5.3 ± 2.1", "3.6 ± 0.4", "17.5 ± 2.6"]


def test_what_is_accepted_is_beside_the_errors_of_all():
    some = {"accepted": 0.9, "rms_accepted_m": 0.03, "p95_accepted_m": 0.05, "max_accepted_m": 0.08}
    lines = report([{**row, **some} for row in ROWS], ["seed"])[0].splitlines()
    for first in ("0", "1", "mean ± std"):
        assert {"90.0 %", "3.0", "8.0"} <= set(cells(lines, first, "DeepGPS"))
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


def test_figures_have_the_names_that_a_study_may_use_and_the_paper_stands_once():
    study = load_study("lab", tiny=False)
    assert set(measure(ROWS)) == set(REPORTS["lab"].targets)
    assert study.paper == {
        f"{method}_label_{name}": figures[place][0]
        for method, figures in PAPER.items()
        for place, name in enumerate(("rms_m", "median_m", "max_m"))
    }


def test_the_study_is_the_papers_experiment():
    plans = plan_runs(load_study("lab", tiny=False))
    assert [plan.scenario.seed for plan in plans] == [0, 1, 2, 3, 4, 5]
    for plan in plans:
        scenario = plan.scenario
        assert (scenario.room.kind, scenario.room.seed, scenario.tag_camera.mounted) == ("lab", 0, True)
        assert (scenario.drive.strategy, scenario.drive.samples, scenario.grid.held_out) == ("endpoint", 1570, 314)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab") / "run"
    (plan,) = plan_runs(load_study("lab", tiny=True))
    kept = plan.scenario.tag_camera.model_copy(update={"kept": True})
    scenario = plan.scenario.model_copy(update={"tag_camera": kept})
    make_recording(scenario, folder / "recording", ignore)
    train(scenario, folder, ignore)
    evaluate(scenario, folder, ignore)
    show(scenario, folder, ignore)
    return folder


def test_errors_against_labels_and_truth_can_be_computed_again(run: Path):
    metrics = json.loads((run / "metrics.json").read_text())
    for name, group in (("error_field.npz", lambda one: one), ("label_field.npz", lambda one: one["against_labels"])):
        with np.load(run / name) as field:
            for method in ("deepgps", "posenet"):
                error = np.linalg.norm(field[method] - field["truth"][:, None], axis=-1).max(axis=1)
                assert group(metrics["methods"][method])["rms_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
                assert group(metrics["methods"][method])["max_m"] == pytest.approx(error.max())
    labels = metrics["labels"]
    assert 0 <= labels["unlabelled"] < 120 and 0 <= labels["test_unlabelled"] < 30
    assert labels["median_m"] < 0.01
    assert metrics["test"] == {"held_out": True, "headings": 1}


def test_a_row_gets_its_columns_and_the_places_their_picture(run: Path):
    (plan,) = plan_runs(load_study("lab", tiny=True))
    row = {"method": "deepgps", "run": "one", "seed": plan.scenario.seed, "rms_m": 1.0}
    columns = add(run, row)
    assert set(columns) == {name for name in ROWS[0] if name.startswith(("label", "unlabelled", "test_unlabelled"))}
    (run.parent / "runs").mkdir()
    (run.parent / "runs" / "one").symlink_to(run)
    assert len(draw_places([row], ["seed"], run.parent).axes) == len(plan.scenario.methods)


def test_the_viewer_has_the_run(run: Path):
    paths = {str(chunk.entity_path) for chunk in open_rrd(run / RECORDING).stream()}
    assert {"/world/error_field/deepgps", "/drive/fisheye", "/drive/tag_camera"} <= paths


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"tag_camera.mounted": "true"}, "tag_camera.mounted needs world room, and the world is landmarks"),
        ({"grid.held_out": "5"}, "grid.held_out 5 needs world room, and the world is landmarks"),
    ],
)
def test_a_plane_has_no_camera_and_no_held_out_samples(overrides: dict[str, str], message: str):
    with pytest.raises(InputError, match=message):
        load_scenario("landmarks", overrides)
