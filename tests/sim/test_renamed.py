"""Names of before: each leads to a setting of today, and what was made by them is still opened."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from deepgps.config.scenario import Scenario, load_scenario, write_out
from deepgps.runs.run_folder import open_run
from sim import renamed
from sim.errors import InputError
from sim.files.checksums import sha256, write_lines
from sim.files.json_files import read_json, write_json
from sim.recording.format import open_recording, open_truth
from sim.recording.manifest import Manifest
from tests.helpers.toy import make_toy


def has_setting(dotted: str) -> bool:
    group: object = Scenario()
    for name in dotted.split("."):
        if not hasattr(group, name):
            return False
        group = getattr(group, name)
    return True


@pytest.mark.parametrize("old", renamed.SETTINGS)
def test_every_old_name_is_gone_and_leads_to_one_of_today(old: str):
    now = renamed.name_now(old)
    assert not has_setting(old)
    assert now is None or has_setting(now)


def test_settings_that_kept_their_names_are_left_alone():
    values = load_scenario("living_room", {}).model_dump(mode="json")
    assert renamed.translate(values) == values


def test_a_run_made_before_is_opened_and_a_scenario_of_before_is_not_made(tmp_path: Path):
    scenario = load_scenario("tiny", {"encoder.step_noise": 0.1, "methods": ["deepgps", "dead_reckoned_labels"]})
    text = write_out(scenario).replace("step_noise:", "gap_noise:").replace("- dead_reckoned_labels", "- odometry")
    text = text.replace("deployment:", "use:").replace("tag_camera:", "horizontal:")
    write_lines(tmp_path / "scenario.yaml", text)
    assert open_run(tmp_path) == scenario
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(InputError, match=r"encoder\.gap_noise: it is called encoder\.step_noise now"):
        load_scenario(str(tmp_path / "mine.yaml"), {})


def test_a_run_older_than_exploring_has_random_headings(tmp_path: Path):
    scenario = load_scenario("tiny", {})
    text = write_out(scenario)
    assert open_run(write_run(tmp_path / "new", text)) == scenario
    old = open_run(write_run(tmp_path / "old", text.replace("  headings: explore\n", "")))
    assert old.drive == scenario.drive.model_copy(update={"headings": "random"})
    settings = {"drive": {"samples": 200}}
    assert Manifest(settings=settings).settings == {"drive": {"samples": 200, "headings": "random"}}
    in_a_plane = {"world": "obstacles", **settings}
    assert Manifest(settings=in_a_plane).settings == in_a_plane


def test_a_group_that_was_no_group_gives_way():
    assert renamed.translate({"obstacles": 3, "map": {"carried": 1}}) == {"obstacles": {"relocate_after": 1}}


def write_run(folder: Path, text: str) -> Path:
    folder.mkdir()
    write_lines(folder / "scenario.yaml", text)
    return folder


def test_a_recording_of_schema_1_is_opened(tmp_path: Path):
    toy = make_toy(tmp_path / "toy", samples=60)
    old = tmp_path / "old"
    shutil.copytree(toy.folder, old)
    for now, before in (
        ("observations/landmarks.npy", "observation.npy"),
        ("test/landmarks.npy", "test/observation.npy"),
    ):
        (old / now).rename(old / before)
    (old / "observations").rmdir()
    manifest = read_json(old / "manifest.json")
    del manifest["sensors"]
    odometry = {**manifest["odometry"], "gap_noise": 0.25}
    names = [path.relative_to(old).as_posix() for path in old.rglob("*.np?")]
    sums = {name: sha256(old / name) for name in names}
    settings = {"world": "landmarks", "encoder": {"gap_noise": 0.25}, "map": {"obstacles": 3}}
    manifest |= {"schema": 1, "odometry": odometry, "settings": settings, "sha256": sums}
    write_json(old / "manifest.json", manifest)
    found = open_recording(old)
    assert (found.kind, found.manifest.sensor) == ("vector", "landmarks")
    assert found.manifest.odometry["step_noise"] == 0.25
    assert found.manifest.settings["obstacles"] == {"count": 3}
    for name in ("observation", "reading", "time", "test_observation"):
        np.testing.assert_array_equal(getattr(found, name), getattr(toy, name))
    np.testing.assert_array_equal(open_truth(old).pose, open_truth(toy.folder).pose)


def test_rows_of_a_table_made_before_have_the_names_of_today():
    row = {"run": "a", "encoder.gap_noise": 0.1, "method": "deepgps_aware", "fold_bent": 0.0, "rms_m": 1.0}
    expected = {"run": "a", "encoder.step_noise": 0.1, "method": "deepgps_noise_aware"}
    assert renamed.translate_row(row) == {**expected, "length_error_fraction": 0.0, "rms_m": 1.0}
    study = {"axes": {"map.seed": [0]}, "cases": [{"use.light": 0.5}], "methods": ["odometry", "knn"]}
    expected = {"axes": {"obstacles.seed": [0]}, "cases": [{"deployment.light": 0.5}]}
    assert renamed.translate_study(study) == {**expected, "methods": ["dead_reckoned_labels", "knn"]}
