"""The report's figures are those of metrics.json, in every form it is printed."""

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from deepgps.reports.run_report import (
    COLUMNS,
    describe,
    markdown_report,
    markdown_table,
    print_report,
    read_metrics,
    tabulate,
)
from sim.errors import InputError
from tests.helpers.synthetic_run import make_metrics


@pytest.fixture
def metrics() -> dict:
    truth = np.zeros((4, 2))
    off = np.array([[0.03, 0.0], [0.0, 0.04], [0.0, 0.0], [0.05, 0.0]])[:, None]
    return make_metrics(truth, {"deepgps": np.repeat(off, 2, axis=1), "mine": np.repeat(2 * off, 2, axis=1)}, 96)


def test_the_table_holds_the_metrics_in_centimetres(metrics: dict) -> None:
    headings, rows = tabulate(metrics)
    deepgps = dict(zip(headings, rows[0], strict=True))
    # RMS of 3, 4, 0 and 5 cm: sqrt(50 / 4)
    assert deepgps["RMS [cm]"] == "3.5"
    assert deepgps["median [cm]"] == "3.5"
    assert deepgps["max [cm]"] == "5.0"
    assert deepgps["RMS / side"] == f"{100 * np.sqrt(50 / 4) / 430:.1f} %"
    assert deepgps["align"] == "E2"
    path = dict(zip(headings, rows[2], strict=True))
    assert (path["RMS [cm]"], path["max [cm]"], path["align"]) == ("41.0", "103", "-")
    assert [row[0] for row in rows] == ["DeepGPS", "mine", "Dead reckoning, path"]


def test_a_figure_that_a_method_lacks_is_a_dash_in_both_forms_of_the_table(metrics: dict) -> None:
    del metrics["methods"]["mine"]["scale"]
    headings, rows = tabulate(metrics)
    assert rows[1][headings.index("scale")] == "-"
    lines = markdown_table(metrics).splitlines()
    assert len(lines) == 3 + len(metrics["methods"]) and {line.count("|") for line in lines} == {len(COLUMNS) + 1}


def test_yaw_has_a_column_where_a_method_tells_one_and_that_of_what_is_accepted_below(metrics: dict) -> None:
    assert "yaw [deg]" not in tabulate(metrics)[0]
    values = metrics["methods"]["deepgps"]
    values["yaw_rms_deg"] = 4.0
    for shown in (["4.0", "-", "-"], ["4.0", "0.4", "-", "-"]):
        headings, rows = tabulate(metrics)
        assert [row[headings.index("yaw [deg]")] for row in rows] == shown
        accept_some(values)
        values["yaw_rms_accepted_deg"] = 0.449


def print_at_80(folder: Path, metrics: dict) -> str:
    (folder / "metrics.json").write_text(json.dumps(metrics))
    console = Console(width=80, record=True, file=StringIO())
    print_report(folder, console)
    return console.export_text()


def test_the_report_tells_coverage_time_and_drift(metrics: dict) -> None:
    text = markdown_report(metrics)
    assert "1 of 4 reachable test positions (25.0 %)" in text
    assert "collect 92.3 s, train 140.1 s, evaluate 12.4 s; 244.8 s in all" in text
    assert "best aligned with the true one, is off by RMS 0.41 m, at most 1.03 m" in text
    assert "mujoco 3.17.0" in text
    assert len(describe({**metrics, "trajectory": None})) == len(describe(metrics)) - 1


def test_segments_that_noise_does_not_explain_are_counted_only_where_there_are_some(metrics: dict) -> None:
    distances = {"segment_rms_m": 0.02, "segment_expected_m": 0.01, "segments_wrong": 0, "wrong_doubted": 0}
    for wrong, found, said in ((0, 0, False), (3, 2, True)):
        counted = {**distances, "segments_wrong": wrong, "wrong_doubted": found}
        text = " ".join(describe({**metrics, "distances": counted}))
        assert "RMS error of 2.00 cm; theory predicts 1.00 cm." in text
        assert ("Of them, 3 have larger errors" in text and "on 2 of these the wheels disagree." in text) == said


def test_words_are_those_of_what_was_tested(metrics: dict) -> None:
    worst, reachable = "on the test grid for the worst heading of each position;", "reachable test positions"
    for test, errors, places in (
        ({}, worst, reachable),
        ({"held_out": False, "headings": 4}, worst, reachable),
        ({"held_out": False, "headings": 1}, "on the test grid;", reachable),
        ({"held_out": True, "headings": 1}, "at test samples of the same drive;", "test samples"),
    ):
        text = markdown_report({**metrics, "test": test})
        assert f"Errors {errors}" in text
        assert f"1 of 4 {places} (25.0 %) are within" in text


def test_what_is_printed_fits_eighty_columns_and_keeps_its_units(tmp_path: Path, metrics: dict) -> None:
    metrics["methods"]["deepgps"]["yaw_rms_deg"] = 113.4
    metrics["methods"]["my [/x]"] = metrics["methods"].pop("mine")
    metrics["in_use"] = {"samples": 40}
    for values in metrics["methods"].values():
        accept_some(values)
        values["in_use"] = {"rms_m": 0.05, "median_m": 0.02}
    text = print_at_80(tmp_path, metrics)
    assert "[cm]" in text and "deployment drive [cm]:" in text.replace("\n", " ").replace("  ", " ")
    assert "…" not in text and "my [/x]" in text, "brackets in the name of a method are no markup"
    assert "0.8 %" in text


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    for content, message in (("", "is not a run: it has no metrics.json"), ("{", "JSON"), ('{"a": 1}', "no methods")):
        if content:
            (tmp_path / "metrics.json").write_text(content)
        with pytest.raises(InputError, match=message):
            read_metrics(tmp_path)


def test_the_lean_of_the_camera_and_the_deployment_drive_are_reported(metrics: dict) -> None:
    before = describe(metrics)
    assert not any("leans" in sentence or "in deployment" in sentence for sentence in before)
    metrics["in_use"] = {"samples": 40}
    metrics["methods"]["mine"] |= {"lean_roll_deg": 0.02, "lean_pitch_deg": 0.0, "wobble_deg": 0.1}
    metrics["methods"]["mine"]["in_use"] = {"rms_m": 0.05, "median_m": 0.02}
    assert not any("leans" in sentence for sentence in describe(metrics)), "too little to be seen"
    metrics["methods"]["mine"]["in_use"] |= {"lean_roll_deg": 2.0, "lean_pitch_deg": -0.1, "wobble_deg": 0.6}
    after = describe(metrics)
    assert [sentence for sentence in after if sentence not in before] == [
        "By its turns, the camera leans 0.02° to the right and 0.00° forward in training, 2.00° to the right and "
        "-0.10° forward in deployment.",
        "It wobbles by 0.6°, in training by 0.1°: errors exceed the radii.",
        "RMS (median) on the 40 images of the deployment drive [cm]: mine 5.0 (2.0).",
    ]


def accept_some(values: dict) -> None:
    """What evaluation adds for a method that refuses images."""
    values |= {"accepted": 0.981, "accepted_places": 0.994, "radius_68_holds": 0.66, "radius_95_holds": 0.94}
    values |= {f"{name}_accepted_m": 0.011 for name in ("rms", "median", "p75", "p95", "max")}


def test_errors_of_what_is_accepted_are_below_those_of_all(metrics: dict) -> None:
    headings, rows = tabulate(metrics)
    accept_some(metrics["methods"]["mine"])
    _, more = tabulate(metrics)
    assert more[:2] == rows[:2] and len(more) == 4
    accepted = dict(zip(headings, more[2], strict=True))
    assert accepted["method"].strip() == "98.1 % accepted"
    assert accepted["RMS [cm]"] == accepted["p95 [cm]"] == accepted["max [cm]"] == "1.1"
    assert accepted["train [s]"] == accepted["align"] == ""
