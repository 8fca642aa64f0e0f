"""The studies of assets/studies ask what they are meant to ask."""

from itertools import groupby

import pytest

from deepgps.config.scenario import names_in
from deepgps.config.spelling import list_settings
from deepgps.studies.engine.recordings import find_drives
from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.reports import changes
from deepgps.studies.study import load_study
from deepgps.studies.table import read_setting
from sim.errors import InputError
from sim.files import STUDIES
from sim.recording.derive import keep_training_settings
from sim.settings import EncoderSettings, SimSettings


def plan(name: str, full: bool = False) -> list[Plan]:
    return plan_runs(load_study(name, tiny=False, full=full))


def test_every_study_can_be_planned() -> None:
    for name in names_in(STUDIES):
        for tiny in (False, True):
            assert len(plan_runs(load_study(name, tiny))) >= (1 if tiny else 2), name


def test_the_thirty_rooms_are_of_every_kind_and_shape_and_none_that_was_developed_on() -> None:
    rooms = [one.scenario.room for one in plan("rooms30")]
    assert (len(rooms), len({(room.kind, room.shape) for room in rooms})) == (30, 24)
    assert min(room.seed for room in rooms) >= 30


def test_every_fault_of_the_camera_has_words_and_is_in_a_study() -> None:
    groups = ("image_faults", "camera_mount", "deployment", "deployment.image_faults")
    known = {name for name, _ in list_settings(SimSettings) if name.rpartition(".")[0] in groups}
    assert known - set(changes.TITLES) == {"deployment.drive_samples"}
    cases = [case for name in ("camera", "change", "reality") for case in load_study(name, tiny=False).cases]
    assert set(changes.TITLES) - {name for case in cases for name in case} == {"camera_mount.pitch_deg"}
    assert all(len(case) <= 1 for case in load_study("camera", tiny=False).cases)


def test_the_study_of_reality_puts_faults_in_deployment_alone_beside_those_in_training_and_shares_drives() -> None:
    plans = plan("reality")
    names = sorted({name for one in plans for name in one.varied})
    rows = [{"method": "knn", **{name: read_setting(one.scenario, name) for name in names}} for one in plans]
    named = changes.pair_faults(rows, names)
    groups = [(fault, [row["in"] for row in some]) for fault, some in groupby(named, lambda row: row["fault"])]
    pairs = {fault for fault, places in groups if places == [*changes.CHANGE_TIMES.values()][::-1]}
    assert len(groups) == len({fault for fault, _ in groups}) == 21
    assert len(pairs) == 12 and {"daylight x 0.3", "JPEG of 10 kB", "a person in view", "wobbling by 1°"} < pairs
    assert len({keep_training_settings(drive.sim).model_dump_json() for drive in find_drives(plans).values()}) == 11


def test_the_camera_study_draws_nothing_again_for_faults_of_finished_images() -> None:
    plans = plan("camera")
    drives = find_drives(plans)
    finished = [one for one in plans if not any(name.startswith(("camera_mount", "deployment")) for name in one.varied)]
    assert len({one.recording for one in finished}) == len(finished)
    assert len({drives[one.recording].model_dump_json() for one in finished}) == 2  # one a seed
    assert len({drive.model_dump_json() for drive in drives.values()}) == 2 + len(plans) - len(finished)


def test_the_encoder_study_asks_of_every_fault_with_five_seeds_and_shares_five_drives_of_each_robot() -> None:
    plans = plan("encoder")
    asked = {name for one in plans for name in EncoderSettings.model_fields if name in str(dict(one.varied))}
    assert asked == set(EncoderSettings.model_fields) - {"plugins"}
    robots = {one.scenario.robot.wheel_radius_error for one in plans}
    assert (len(robots), len({one.scenario.seed for one in plans})) == (3, 5)
    assert len({drive.model_dump_json() for drive in find_drives(plans).values()}) == 5 * len(robots)


def test_networks_are_trained_where_they_are_asked_for() -> None:
    few, all_ = (load_study("encoder", tiny=True, networks=networks) for networks in (False, True))
    assert few.methods == ("registration", "registration_distances")
    assert all_.methods == (*(few.methods or ()), "deepgps_compass", "deepgps", "dead_reckoned_labels", "posenet")
    with pytest.raises(InputError, match="study knowing has no further methods: --networks"):
        load_study("knowing", tiny=True, networks=True)
