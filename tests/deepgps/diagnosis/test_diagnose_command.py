"""The command ``deepgps diagnose``: what it prints and writes, and what it refuses."""

import shutil
from pathlib import Path

from deepgps.diagnosis.store import FILE
from sim.files.checksums import read_json, write_json
from tests.helpers.command import assert_one_clear_line, deepgps_here


def test_a_recording_is_diagnosed_and_a_file_written_where_one_is_named(small_recording: Path, tmp_path: Path):
    done = deepgps_here("diagnose", str(small_recording), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for said in ("Nothing is wrong", "track width", "95 % interval", "What cannot be known"):
        assert said in done.stdout
    assert list(tmp_path.iterdir()) == []
    done = deepgps_here("diagnose", str(small_recording), "--out", "found.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "wrote found.json" in done.stdout
    stored = read_json(tmp_path / "found.json")
    assert set(stored) >= {"format", "quantities", "stretches", "faults", "set", "smallest", "unknown"}
    assert all(value["low"] <= value["value"] <= value["high"] for value in stored["quantities"].values())
    again = deepgps_here("diagnose", str(small_recording), "--out", "found.json", cwd=tmp_path)
    assert again.returncode == 0, "its own file may be written over"


def test_a_run_s_diagnosis_lies_in_its_folder_and_its_view_is_made_again(finished_run: Path, tmp_path: Path):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run, symlinks=True)
    (run / FILE).unlink()
    done = deepgps_here("diagnose", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_json(run / FILE)["turns"] > 0
    assert not (run / "run.rrd").exists(), "it shows no diagnosis, or another one"


def test_what_cannot_be_diagnosed_and_a_foreign_file_are_refused_in_a_line(small_recording: Path, tmp_path: Path):
    for name in ("nothing", "."):
        done = deepgps_here("diagnose", name, cwd=tmp_path)
        assert_one_clear_line(done, 2, "neither a recording", tmp_path)
    (tmp_path / "thesis.json").write_text("{}")
    done = deepgps_here("diagnose", str(small_recording), "--out", "thesis.json", cwd=tmp_path)
    assert (done.returncode, "deepgps did not write it" in done.stderr) == (2, True)
    old = tmp_path / "old"
    shutil.copytree(small_recording, old)
    manifest = read_json(old / "manifest.json")
    for name in ("turns.npy", "observations/fisheye_turn.npy"):
        (old / name).unlink()
        manifest["sha256"].pop(name)
    write_json(old / "manifest.json", manifest)
    done = deepgps_here("diagnose", "old", cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "no images after turns" in done.stderr
