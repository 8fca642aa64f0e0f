"""The command deepgps export: what it writes, where, and what it refuses in one line."""

import itertools
import shutil
from pathlib import Path

import pytest

from deepgps.positioner.pose import find_poses
from deepgps.robot_io import export, trajectories
from sim.errors import InputError
from tests.helpers.command import assert_one_clear_line, deepgps_here


def test_trajectories_go_into_a_folder_of_their_own_again_and_every_image_is_located_once(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "first").symlink_to(finished_run)
    found = []
    monkeypatch.setattr(trajectories, "find_poses", lambda *given: found.append(given) or find_poses(*given))
    words = ("export", "first", "--tum", "--method", "posenet", "--out", "given")
    for times in (1, 2):
        done = deepgps_here(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout == "wrote given/tum\n"
        assert len(found) == 2 * times, "once for each drive"
    written = sorted(path.relative_to(tmp_path / "given").as_posix() for path in tmp_path.rglob("given/*/*/*"))
    files = itertools.product(("training", "use"), ("posenet", "truth"))
    assert written == [f"tum/{drive}/{name}.tum" for drive, name in files]


def test_a_run_of_the_same_name_does_not_write_into_the_export_of_another(finished_run: Path, tmp_path: Path):
    for home in ("a", "b"):
        (tmp_path / home).mkdir()
        shutil.copytree(finished_run, tmp_path / home / "one", symlinks=True)
    assert deepgps_here("export", "a/one", "--tum", cwd=tmp_path).returncode == 0
    before = {path: path.read_bytes() for path in (tmp_path / "export").rglob("*") if path.is_file()}
    done = deepgps_here("export", "b/one", "--tum", "--method", "posenet", cwd=tmp_path)
    held = (
        f"holds an export of the run {tmp_path / 'a' / 'one'}, not of {tmp_path / 'b' / 'one'}; choose another folder"
    )
    assert (done.returncode, held in done.stderr) == (2, True)
    assert {path: path.read_bytes() for path in (tmp_path / "export").rglob("*") if path.is_file()} == before
    assert deepgps_here("export", "b/one", "--tum", "--out", "other", cwd=tmp_path).returncode == 0


def test_an_export_that_is_refused_leaves_nothing(finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> None:
        raise InputError("no times")

    monkeypatch.setattr("deepgps.robot_io.export.write_trajectories", refuse)
    assert_one_clear_line(deepgps_here("export", str(finished_run), "--tum", cwd=tmp_path), 2, "no times", tmp_path)


def test_a_method_is_written_as_onnx(finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(export, "build_model", lambda *_: b"a model")  # which takes its time
    words = ("--onnx", "--frame", "map", "--centre", "60", "58", "--radius-px", "50", "--out", "robot")
    done = deepgps_here("export", str(finished_run), *words, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "wrote robot/onnx\n"), done.stderr
    names = {path.name for path in (tmp_path / "robot" / "onnx").iterdir()}
    assert names == {"model.onnx", "meta.json", "tables.npz", "example.py", *(f"{name}.py" for name in export.MODULES)}
    assert '"frame": "map"' in (tmp_path / "robot" / "onnx" / "meta.json").read_text()


def test_wrong_words_are_refused_and_a_folder_of_the_user_s_is_left_alone(finished_run: Path, tmp_path: Path):
    for words, said in (
        ((), "needs --tum, --onnx or both"),
        (("--onnx", "--radius-px", "9"), "--centre and --radius-px: give both"),
        (("--tum", "--centre", "9", "9", "--radius-px", "9"), "--centre and --radius-px are for --onnx"),
        (("--onnx", "--centre", "9", "inf", "--radius-px", "9"), "--centre 9 inf: "),
        (("--tum", "--method", "pca_knn"), "method 'pca_knn': "),
    ):
        assert_one_clear_line(deepgps_here("export", str(finished_run), *words, cwd=tmp_path), 2, said, tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    done = deepgps_here("export", str(finished_run), "--tum", "--out", ".", cwd=tmp_path)
    assert done.returncode == 2 and "is neither empty nor a export folder of deepgps" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
