"""Every command run small, as a user runs it, and its errors by their text."""

import json
import subprocess
import sys

import numpy as np
import pytest

from deepgps.config.scenario import names_in
from sim.files import STUDIES
from sim.recording.format import check_recording, read_manifest
from sim.robot_log.mcap_file import read_key
from tests.helpers.command import MINI, arrays, assert_one_clear_line, deepgps, deepgps_here, wait_until

ONE_LINE_ERRORS = [
    (["run", "living_room", "--room.seed", "1", "2"], "--room.seed takes one value, not 1 2"),
    (["run", "nowhere"], "scenario 'nowhere' does not exist; there are corridor, demo, flat, lab, labyrinth"),
    (["run"], "deepgps run needs a scenario first"),
    (["fly"], "command 'fly' does not exist; there are run, collect"),
    (["study"], f"deepgps study needs a study first: {', '.join(names_in(STUDIES))}, or a path"),
    (["study", "zzz"], f"study 'zzz' does not exist; there are {', '.join(names_in(STUDIES))}, or a path"),
    (["view", "."], "is no run folder: it has no scenario.yaml"),
    (["view"], "deepgps view takes one folder, or two to compare, not 0"),
    (["view", "nowhere"], "nowhere does not exist"),
    (["train", "."], ". is neither a run (it has no scenario.yaml) nor a recording (it has no manifest.json)"),
    (["rooms", "--kinds", "attic"], "--kinds 'attic' does not exist; there are all, living_room"),
    (["rooms", "--seeds", "3-x"], "--seeds '3-x': one to a hundred whole numbers"),
    (["rooms", "--seeds", f"0-{10**30}"], f"--seeds '0-{10**30}': one to a hundred whole numbers"),
    (["study", "samples", "--engine", "x"], "invalid choice 'x'"),
    (["view", "a", "--port", "x"], "error: deepgps view: --port x: must be INT"),
]


def test_wrong_words_give_one_clear_line(tmp_path):
    for words, message in ONE_LINE_ERRORS:
        assert_one_clear_line(deepgps_here(*words, cwd=tmp_path), 2, message, tmp_path)


def test_a_world_without_a_camera_needs_no_renderer(tmp_path):
    words = ("collect", "landmarks", "--landmarks.segments", "4", "--grid.spacing-m", "0.5", "--out", "plane")
    done = deepgps(*words, cwd=tmp_path, MUJOCO_GL="nothing")
    assert done.returncode == 0, done.stderr
    check_recording(tmp_path / "plane" / "recording")
    refused = deepgps("collect", "tiny", "--out", "room", cwd=tmp_path, MUJOCO_GL="nothing")
    assert refused.returncode == 2 and "MUJOCO_GL" in refused.stderr and refused.stderr.count("\n") == 1


@pytest.mark.slow
def test_figures_are_drawn_whatever_backend_the_environment_names(tmp_path):
    words = ("landmarks", "--landmarks.segments", "12", "--grid.spacing-m", "0.5", "--methods", "knn", "--out", "a")
    done = deepgps("run", *words, cwd=tmp_path, MPLBACKEND="module://missing")  # as Jupyter names one that it has
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "a" / "figures").glob("*.png"))


@pytest.mark.slow
def test_a_log_changes_nothing_in_the_recording(tmp_path):
    (tmp_path / "mini.yaml").write_text(MINI)
    words = ("collect", "mini.yaml", "--drive.samples", "16", "--out")
    for more in (("with", "--log", "drive.mcap"), ("without",)):
        done = deepgps_here(*words, *more, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    one, other = (read_manifest(tmp_path / name / "recording").sha256 for name in ("with", "without"))
    timed = {"use/manifest.json"}  # which says how long its drive took
    assert {name: one[name] for name in one.keys() - timed} == {name: other[name] for name in other.keys() - timed}
    assert read_key(tmp_path / "drive.mcap")
    again = deepgps_here(*words, "with", "--log", "drive.mcap", cwd=tmp_path)
    assert "drive.mcap is complete already" in again.stderr
    (tmp_path / "drive.mcap").write_text("holiday")
    done = deepgps_here(*words, "other", "--log", "drive.mcap", cwd=tmp_path)
    assert done.returncode == 2
    assert "drive.mcap exists, and deepgps did not write it" in done.stderr
    assert not (tmp_path / "other").exists()


def test_a_room_that_reaches_out_of_its_folder_is_refused(tmp_path, tmp_path_factory):
    folder = tmp_path_factory.mktemp("house") / "rooms"
    folder.mkdir()
    (folder.parent / "secret.xml").write_text("<mujoco/>")
    (folder / "room.xml").write_text('<mujoco><include file="../secret.xml"/></mujoco>')
    done = deepgps_here("run", "tiny", "--room.mjcf", str(folder / "room.xml"), "--out", "new/deep", cwd=tmp_path)
    assert_one_clear_line(done, 2, "../secret.xml", tmp_path)


@pytest.mark.slow
def test_a_run_leaves_all_that_was_promised(finished_run):
    for name in ("scenario.yaml", "metrics.json", "error_field.npz", "run.rrd", "log.txt", "recording/scene.glb"):
        assert (finished_run / name).is_file(), name
    assert list((finished_run / "figures").glob("*.png"))
    check_recording(finished_run / "recording")
    assert not list(finished_run.rglob("*.part"))
    said = (finished_run.parent / "said.txt").read_text()
    for word in ("DeepGPS", "PoseNet", "collect", "deepgps view"):
        assert word in said


@pytest.mark.slow
def test_every_figure_can_be_computed_again_from_the_error_field(finished_run):
    metrics = json.loads((finished_run / "metrics.json").read_text())
    field = np.load(finished_run / "error_field.npz")
    assert set(metrics["methods"]) == {"deepgps_compass", "deepgps", "posenet", "knn"}
    for name, values in metrics["methods"].items():
        worst = np.linalg.norm(field[name] - field["truth"][:, None], axis=-1).max(axis=1)
        assert values["rms_m"] == pytest.approx(np.sqrt((worst**2).mean()))
        assert values["median_m"] == pytest.approx(np.median(worst))
        assert values["max_m"] == pytest.approx(worst.max())
        assert values["relative_rms"] == pytest.approx(values["rms_m"] / metrics["shorter_side_m"])
        assert {"scale", "alignment", "steps", "train_s", "parameters", "p75_m", "p95_m"} <= set(values)


@pytest.mark.slow
def test_done_work_is_not_done_again(finished_run):
    before = {path: path.stat().st_mtime_ns for path in finished_run.rglob("*") if path.name != ".deepgps"}
    done = deepgps_here("run", "mini.yaml", "--out", "run", cwd=finished_run.parent)
    assert done.returncode == 0
    assert "DeepGPS" in done.stdout
    changed = [path.name for path, time in before.items() if path.stat().st_mtime_ns != time]
    assert not changed


MOMENTS = ("recording.collecting/drive-*.npz", "deepgps/**/checkpoint.pt", "metrics.json")
"""Files that show a run in the drive or rendering, in a training, and between measuring and the last figure."""


@pytest.mark.slow
def test_killed_again_and_again_it_ends_with_the_same_bytes(finished_run, tmp_path):
    (tmp_path / "mini.yaml").write_text(MINI)
    command = [sys.executable, "-m", "deepgps.commands.main", "run", "mini.yaml", "--out", "two"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "text": True}
    for moment in MOMENTS:
        with subprocess.Popen(command, cwd=tmp_path, **quiet) as process:
            wait_until(lambda moment=moment: list(tmp_path.glob(f"two/{moment}")), process)
            process.kill()
    assert not (tmp_path / "two" / "run.rrd").exists()
    done = deepgps("run", "mini.yaml", "--out", "two", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert arrays(tmp_path / "two") == arrays(finished_run)


def test_a_folder_with_brackets_and_a_blank_is_printed_as_a_word_of_a_command(tmp_path):
    done = deepgps_here("collect", "landmarks", "--drive.samples", "40", "--out", "a[/bold] run [living]", cwd=tmp_path)
    assert done.returncode == 0
    assert "collect is done: a[/bold] run [living]" in done.stdout
