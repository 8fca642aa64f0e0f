"""``deepgps navigate`` on a small run: what it refuses, what it writes, and that a killed one continues."""

import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.api.run import load
from deepgps.evaluation import navigate_run
from deepgps.evaluation.navigate_run import Order
from deepgps.runs.run_folder import RUN
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.files.atomic import list_files
from sim.files.checksums import read_json
from sim.recording.format import open_recording
from tests.helpers.command import deepgps_here, started, wait_until


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--to", "99", "0"), "has driven no floor there"),
        (("--to", "nan", "0"), "two finite numbers"),
        (("--goals", "0"), "must be from 1"),
        (("--methods", "magic"), "has deepgps_compass"),
    ],
)
def test_bad_input_is_refused_in_one_line(finished_run: Path, words, said):
    done = deepgps_here("navigate", str(finished_run), *words, cwd=finished_run.parent)
    assert done.returncode == 2 and said in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_runs_without_a_robot_a_map_or_a_camera_are_refused(finished_run: Path, tmp_path: Path, monkeypatch):
    recording, bare = open_recording(finished_run / "recording"), tmp_path / "run"
    shutil.copytree(finished_run, bare, ignore=shutil.ignore_patterns("positioner.json"))
    with pytest.raises(InputError, match="has no map"):
        navigate_run.navigate_run(bare, Order(1), ignore)
    for change, said in (({"source": "log"}, "no simulated robot"), ({"sensors": {"lidar": "scan"}}, "only a camera")):
        other = replace(recording, manifest=recording.manifest.model_copy(update=change))
        monkeypatch.setattr(navigate_run, "open_recording", lambda _, other=other: other)
        with pytest.raises(InputError, match=said):
            navigate_run.navigate_run(finished_run, Order(1), ignore)


def test_a_run_has_a_navigator(finished_run: Path):
    navigator = load(finished_run).navigator()
    assert navigator.floor.free.any() and np.isnan(navigator.source.pose()).all()


@pytest.mark.slow
def test_a_killed_command_continues_with_the_same_bytes(finished_run: Path, tmp_path: Path):
    command, files = ("navigate", "run", "--goals", "3", "--methods", "truth", "deepgps_compass"), {}
    for name in ("whole", "killed"):
        shutil.copytree(finished_run, tmp_path / name / "run")
    with started(sys.executable, "-m", "deepgps.commands.main", *command, cwd=tmp_path / "killed") as process:
        wait_until(lambda: list((tmp_path / "killed").glob("run/navigate/parts/*.npz")), process)
    for name in ("whole", "killed"):
        done = deepgps_here(*command, cwd=tmp_path / name)
        assert done.returncode == 0, done.stderr
        folder = tmp_path / name / "run/navigate"
        assert (folder / "deepgps_compass.rrd").is_file()  # whose bytes Rerun decides
        files[name] = {path.name: path.read_bytes() for path in folder.rglob("*.[jn]*")}
        assert "Shares of goals reached" in done.stdout
    assert files["whole"] == files["killed"] and {"metrics.json", "truth.npz"} < set(files["whole"])
    figures = read_json(tmp_path / "whole/run/navigate/metrics.json")["methods"]
    assert set(figures) == {"truth", "deepgps_compass"} and 0.0 <= figures["truth"]["success_0_2m"] <= 1.0
    ours = {str(path.relative_to(tmp_path / "whole/run")) for path in list_files(tmp_path / "whole/run", RUN.files)}
    assert {str(path.relative_to(tmp_path / "whole/run")) for path in folder_files(tmp_path / "whole/run")} <= ours


def folder_files(run: Path) -> list[Path]:
    return [path for path in (run / "navigate").rglob("*") if path.is_file() and not re.search("[.]sha256$", path.name)]
