"""The study of what a method knows of itself: its report from made-up drives, and the drives that it derives."""

import json
from pathlib import Path

import numpy as np
import pytest

from deepgps.data.segments import find_runs
from deepgps.studies.catalog import REPORTS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.changes import DRIVES
from deepgps.studies.reports.knowing import (
    EXPECTED_CAUSES,
    SPOILS,
    add_drives,
    find_expected,
    keep_segments,
    spoil_drive,
)
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.tracking.causes import TITLES
from sim.errors import InputError
from sim.files.checksums import write_json
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import KINDS, NO_IMAGE, check_turns
from tests.helpers.reports import find_line, read_cells, report_rows

LIGHT = "deployment.light"


def make_row(light: float, *drives: dict) -> Row:
    return {"method": "deepgps_compass", "flipped": 0.0, LIGHT: light, DRIVES: json.dumps(drives)} | dict.fromkeys(
        ("rms_m", "median_m", "p95_m", "max_m"), 0.1
    )


def tell(fault: str, expected: str, accepted: float, named: list[str], **shares: float) -> dict:
    causes = {"named": named, "shares": shares, "refused": shares, "lean_deg": None, "gain": None}
    figures = {"large_refused": 0.5} if expected == "furniture" else {}
    return {"fault": fault, "expected": expected, "accepted": accepted, "causes": causes, "figures": figures}


ROWS = [
    make_row(
        1.0,
        tell("", "", 0.98, [], furniture=0.02),
        tell("lens covered", "covered", 0.0, ["covered"], covered=1.0),
        tell("another room", "other_room", 0.01, ["other_room"], other_room=0.96, new_place=0.04),
    ),
    make_row(0.2, tell("", "light", 0.9, ["furniture"], furniture=0.06, light=0.04)),
]


def test_each_drive_has_a_line_with_what_is_refused_and_named_and_figures_count_the_right_causes():
    text, figures = report_rows("knowing", ROWS, [LIGHT])
    assert text.startswith("## DeepGPS, compass, features of ranks, one room\n")
    assert [line[0] for line in read_cells(text)] == ["no change", "lens covered", "another room", "all light x 0.2"]
    assert find_line(text, "all light x 0.2")[:2] == ["10.0", TITLES["furniture"]]
    values = {name: figure.value for name, figure in figures.items()}
    right = {"drives_right": 2 / 3, "images_right": (1.0 + 0.96 + 0.4) / 3, "clean_refused": 0.02}
    assert values == pytest.approx(right | {"other_room_refused": 0.99, "covered_refused": 1.0})
    assert {target.name for target in REPORTS["knowing"].targets} == set(values) | {"moved_refused"}


@pytest.mark.parametrize("more", [{}, {"in_use": {"rms_m": 0.1, "median_m": 0.1}}])
def test_methods_that_refuse_nothing_are_named(more: dict, tmp_path: Path):
    write_json(tmp_path / "metrics.json", {"methods": {"knn": {"rms_m": 0.1, **more}}})
    with pytest.raises(InputError, match=r"knowing needs a deployment drive.*which Nearest neighbour does not"):
        add_drives(tmp_path, {"method": "knn"})


def test_every_fault_of_the_study_has_a_cause():
    plans = plan_runs(load_study("knowing", tiny=False))
    assert {name for plan in plans for name in plan.varied if name.startswith("deployment.")} == {
        name for names in EXPECTED_CAUSES.values() for name in names
    }
    assert {find_expected(dict(plan.varied)) for plan in plans} == {"", *EXPECTED_CAUSES}
    assert set(SPOILS) | {*EXPECTED_CAUSES, "other_room", "new_place"} == set(TITLES)


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


def test_spoilt_images_are_what_they_are_called(recording: Recording):
    images = {name: spoil_drive(recording, spoil).observation for name, spoil in SPOILS.items()}
    assert (images["black"] == 0).all()
    assert (images["white"] == 255).all()
    assert (images["frozen"] == recording.observation[0]).all()
    assert np.ptp(images["covered"], axis=(1, 2)).max() < 0.03 * np.ptp(recording.observation, axis=(1, 2)).max() + 2


def test_what_is_left_of_a_recording_is_one_itself(recording: Recording):
    place = open_truth(recording.folder).pose[:, 0]
    seen = place < np.quantile(place, 0.7)
    part = keep_segments(recording, seen)
    assert part.turns is not None
    assert part.turn_observation is not None
    check_turns(part.turns.array, len(part.observation), len(part.turn_observation), part.reading[:, 0])
    whole = [run for run in find_runs(recording) if seen[recording.reading[run, 1]].all()]
    assert [len(run) for run in find_runs(part)] == [len(run) for run in whole]
    assert (part.reading[:, 2:] == np.concatenate([recording.reading[run, 2:] for run in whole])).all()
    for run, old in zip(find_runs(part), whole, strict=True):
        observed = part.observation[part.reading[run, 1]]
        assert (observed == recording.observation[recording.reading[old, 1]]).all()
    assert len(part.turns.after) == len(whole) - 1
    in_place = part.turns.image != NO_IMAGE
    assert (part.turns.kind[in_place] == KINDS.index("in_place")).all()
    every = keep_segments(recording, np.ones(len(place), bool)).turns
    assert every is not None
    assert recording.turns is not None
    assert (every.array == recording.turns.array).all()
