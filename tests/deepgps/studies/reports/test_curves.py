"""The report of curves from made-up rows: knees, targets, and what is drawn."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.studies.catalog import REPORTS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.curves import KNEE, draw, find_knee, measure, report
from deepgps.studies.reports.report import write_report
from deepgps.studies.study import load_study
from deepgps.studies.table import Row

SAMPLES = (500.0, 1000.0, 4000.0, 16000.0)


def make_rows(
    rms: dict[tuple[str, str], dict[float, tuple[float, ...]]], axis: str = "encoder.step_noise"
) -> list[Row]:
    """A row for each scenario, method, value of the axis and seed, in the order of a table's columns."""
    return [
        {"run": "r", "seed": seed, "learn.knob": 1, "scenario": scenario, axis: value, "samples": 100}
        | {"method": method, "rms_m": one, "median_m": one / 2, "p95_m": 2 * one, "max_m": 10 * one}
        | {"shorter_side_m": 2.0, "relative_rms": one / 2.0, "train_s": 10.0, "failure": None}
        for (scenario, method), line in rms.items()
        for value, seeds in line.items()
        for seed, one in enumerate(seeds)
    ]


NOISE = make_rows(
    {
        ("landmarks", "deepgps"): {0.0: (0.001, 0.003), 0.1: (0.004, 0.006)},
        ("landmarks", "posenet"): {0.0: (0.002, 0.002), 0.1: (0.002, 0.002)},
        ("living_room", "deepgps"): {0.0: (0.02, 0.02), 0.1: (0.03, 0.05)},
    }
)


def make_line(*rms: float) -> list[Row]:
    lines: dict = {("living_room", "deepgps"): dict(zip(SAMPLES, ((one,) for one in rms), strict=True))}
    return make_rows(lines, "drive.samples")


def cells(text: str, *first: str) -> list[str]:
    """The cells of the one line that begins with these."""
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    (line,) = [line for line in found if tuple(line[: len(first)]) == first]
    return line


def test_every_value_has_the_mean_of_its_seeds_and_the_worst_beside_the_papers_bound():
    table = report(NOISE, [])[0]
    ours = ["2", "0.5", "0.25", "1", "5", "0.6", "0.25 %", "10"]
    assert cells(table, "landmarks", "DeepGPS", "0.1")[3:] == [*ours, "< 4"]
    assert cells(table, "landmarks", "PoseNet", "0.1")[-1] == "-"
    assert "learn.knob" not in table  # it tells nothing apart


def test_targets_are_judged_at_the_highest_value_in_the_worst_case():
    figures = measure(NOISE)
    assert set(figures) <= set(REPORTS["curves"].targets)
    assert figures["relative_rms"].value == pytest.approx(0.02)
    assert figures["relative_rms"].worst == pytest.approx(0.025)
    assert figures["relative_median"].value == pytest.approx(0.01)
    assert figures["rms_m"].value == pytest.approx(0.04)
    assert "knee" not in figures  # what rises has none
    study = load_study("noise_w", tiny=False)
    text = write_report(study, plan_runs(study)[:1], {}, NOISE)
    line = cells(text, "RMS / side at encoder.step_noise 0.1")
    assert line[1:] == ["2.0 %", "-", "2.5 %", "<= 2.0 %", "met", "2.0 %"]


def test_the_knee_is_where_the_line_becomes_flat():
    rows = make_line(0.2, 0.08, 0.049, 0.04)
    assert find_knee(rows, "drive.samples") == 4000
    assert measure(rows)["knee"].value == 4000
    text = report(rows, [])
    assert cells(text[0], "DeepGPS", "1000")[-1] == "4"
    assert "drive.samples 4000, the smallest value" in text[1]


def test_a_line_that_still_falls_at_its_end_has_no_knee():
    rows = make_line(0.2, 0.08, 0.06, 0.04)
    assert find_knee(rows, "drive.samples") is None
    assert "knee" not in measure(rows)
    assert "knee" not in "\n".join(report(rows, []))


@given(rms=st.tuples(*[st.floats(0.001, 1.0)] * 4))
def test_from_the_knee_on_all_are_within_and_the_one_before_is_not(rms: tuple[float, ...]):
    knee, within = find_knee(make_line(*rms), "drive.samples"), [one <= KNEE * rms[-1] for one in rms]
    if knee is None:
        assert all(within) or not within[-2]
    else:
        place = SAMPLES.index(knee)
        assert all(within[place:]) and not within[place - 1] and place < len(rms) - 1


def test_curves_run_through_the_means_and_bands_from_best_to_worst():
    panels = draw(NOISE, [], Path()).axes
    assert [axes.get_title() for axes in panels] == ["landmarks", "living_room"]
    lines = {line.get_label(): line for line in panels[0].lines}
    np.testing.assert_allclose(np.asarray(lines["DeepGPS, RMS"].get_ydata()), [0.2, 0.5])
    np.testing.assert_allclose(np.asarray(lines["paper: below 2 % of the side"].get_ydata()), 4.0)
    band = np.asarray(panels[0].collections[0].get_paths()[0].vertices)
    np.testing.assert_allclose([band[:, 1].min(), band[:, 1].max()], [0.1, 0.6])
    assert panels[0].get_xscale() == "linear"
    (panel,) = draw(make_line(0.2, 0.08, 0.05, 0.04), [], Path()).axes
    assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
    (paper,) = [line for line in panel.lines if line.get_label() == "paper's RMS"]
    assert np.asarray(paper.get_xydata()).tolist() == [[1000.0, 4.0]]
