"""What a run says of itself: that a map did not converge, which part was missed."""

import numpy as np

from deepgps.evaluation.measures import measure_coverage, name_part
from deepgps.reports.run_report import judge_run, markdown_report
from deepgps.studies.study import Study
from tests.helpers.synthetic_run import make_metrics

SOUND = {"scale": 1.01, "relative_rms": 0.02, "fold": {"found": False}}
GRID = np.stack(np.meshgrid(np.arange(-2, 2.1, 0.1), np.arange(-1, 1.1, 0.1)), axis=-1).reshape(-1, 2)


def make(seen: int = 100, missed: str | None = None, **figures) -> dict:
    coverage = {"reachable_cells": 100, "cells_seen": seen, **({"missed": missed} if missed else {})}
    return {"coverage": coverage, "methods": {"deepgps": {**SOUND, **figures}, "knn": SOUND}}


def test_a_map_that_cannot_be_right_is_named_with_all_reasons():
    for figures, reason in (
        ({"scale": 0.64}, "scale 0.64"),
        ({"scale": 1.2}, "scale 1.20"),
        ({"fold": {"found": True}}, "the map is folded"),
        ({"relative_rms": 0.24}, "RMS 24 % of the room's shorter side"),
        ({"scale": 0.5, "relative_rms": 0.3}, "scale 0.50, RMS 30 % of the room's shorter side"),
    ):
        assert judge_run(make(**figures)) == [f"Not converged: DeepGPS ({reason})."]  # pyright: ignore
    assert judge_run(make()) == []


def test_a_small_part_that_is_turned_is_named_and_a_large_one_makes_the_map_wrong():
    for share, begin in ((0.041, "Not converged: DeepGPS (131 images, 4.1 %"), (0.0141, "DeepGPS: 131 images, 1.4 %")):
        turned = {"share": share, "parts": [131], "turns": 182}
        (line,) = judge_run(make(turned=turned))
        assert line.startswith(begin) and "mirrored or turned by the compass" in line
        assert judge_run(make(turned={**turned, "parts": []})) == []


def test_a_drive_that_missed_a_part_says_which_and_what_to_do():
    assert judge_run(make(seen=89, missed="north-west")) == [
        "The drive missed 11 % of the room, mostly in the north-west: drive more, with --drive.samples."
    ]
    assert judge_run(make(seen=90, missed="north-west")) == []
    assert judge_run(make(seen=50)) == ["The drive missed 50 % of the room: drive more, with --drive.samples."]


def test_the_report_holds_the_verdict():
    truth = np.zeros((4, 2))
    metrics = make_metrics(truth, {"deepgps": truth[:, None] + 9.0}, 100)
    assert "**Not converged: DeepGPS (RMS" in markdown_report({**metrics, "environment": {}})


def test_the_missed_part_has_a_direction():
    for x, y, part in ((-1, 1, "north-west"), (0, -1, "south"), (1, 0, "east"), (1, -1, "south-east"), (0, 0, None)):
        chosen = np.ones(len(GRID), bool)
        for axis, side in enumerate((x, y)):
            chosen &= (np.sign(GRID[:, axis].round(6)) == side) if side else True
        assert name_part(GRID, chosen) == part
    assert name_part(GRID, np.ones(len(GRID), bool)) is None


def test_coverage_names_what_no_sample_is_near():
    coverage = measure_coverage(GRID, GRID[(GRID[:, 0] < 0) | (GRID[:, 1] < 0)])
    assert coverage["missed"] == "north-east"
    assert coverage["cells_seen"] < coverage["reachable_cells"] == len(GRID)
    assert "missed" not in measure_coverage(GRID, GRID)


def test_a_study_over_a_number_draws_curves_unless_it_names_a_report():
    for axes, report in (
        ({"encoder.step_noise": [0, 0.1]}, "curves"),
        ({"room.kind": ["office"], "drive.samples": [100, 200]}, "curves"),
        ({"drive.samples": [100, 200], "room.kind": ["office"]}, "compare"),
        ({"tag_camera.kept": [True, False]}, "compare"),
        ({}, "compare"),
    ):
        assert Study.model_validate({"scenario": "tiny", "axes": axes}).report == report
        assert Study.model_validate({"scenario": "tiny", "axes": axes, "report": "plain"}).report == "plain"


def test_an_undecided_map_is_said_with_its_share_and_parts():
    found = {"undecided": 0.2, "parts": [[3, 5], [10, 90]]}
    for repeats, ending in (({}, "could be mirrored"), ({"repeats_m": 0.62}, "the world repeats every 0.6 m.")):
        (line,) = judge_run(make(map=found | repeats))
        assert line.startswith("DeepGPS: 20.0 % of its map is undecided (2 parts; longest: images 10 to 90)")
        assert ending in line
    assert judge_run(make(map={"undecided": 0.0, "parts": [], "repeats_m": None})) == []
