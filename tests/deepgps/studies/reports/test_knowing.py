"""The study of what a method knows of itself: its report from made-up drives, and the drives that it derives."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.data.segments import find_runs
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.knowing import (
    EXPECTED_CAUSES,
    SPOILS,
    add_drives,
    find_expected,
    keep_segments,
    spoil_drive,
)
from deepgps.studies.study import load_study
from deepgps.tracking.causes import TITLES
from sim.errors import InputError
from sim.files.checksums import write_json
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import KINDS, NO_IMAGE, check_turns


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
