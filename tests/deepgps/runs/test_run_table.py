"""The table of runs: what differs, errors, age; fast, and without torch."""

import os
import sys
import time
from pathlib import Path

import pytest

from deepgps.config.scenario import Scenario, load_scenario
from deepgps.runs.run_folder import TRUTHLESS_METRICS, claim, default_folder, describe_work, list_runs
from deepgps.runs.run_table import compare_with_latest, list_differences, measure_disk, write_age
from sim.files.checksums import write_json
from tests.helpers.command import deepgps_here


def make_run(home: Path, overrides: dict, rms_m: float | None = None, age_s: float = 0.0) -> str:
    scenario = load_scenario("tiny", overrides)
    folder = default_folder(scenario)
    with claim(scenario, home / folder, fresh=False):
        if rms_m is not None:
            write_json(home / folder / "metrics.json", {"methods": {"knn": {"rms_m": rms_m, "median_m": 0.02}}})
    for path in (home / folder).glob("*.*"):
        os.utime(path, (time.time() - age_s, time.time() - age_s))
    return folder.name


def test_runs_are_listed_by_what_they_change(tmp_path: Path):
    names = [
        make_run(tmp_path, {}, 0.041, age_s=7300),
        make_run(tmp_path, {"encoder.step_noise": 0.1, "methods": ["knn", "posenet"]}, 0.4, age_s=130),
        make_run(tmp_path, {"room.seed": 3}),
    ]
    done = deepgps_here("runs", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    heading, *lines, disk = done.stdout.splitlines()
    assert " in all; " in disk
    assert [line.split()[0] for line in lines] == [f"tiny/{name}" for name in names]
    assert [line[heading.index("age") :].split("  ")[0] for line in lines] == ["2 h", "2 min", "0 s"]
    errors = [line[heading.index("RMS") : heading.index("differs")].strip() for line in lines]
    nearest = "Nearest neighbour"
    assert errors == [f"{nearest} 4.1 (2.0)", f"{nearest} 40.0 (2.0)", "no finished recording"]
    changes = [line[heading.index("differs") :] for line in lines]
    assert changes == ["nothing", "--encoder.step-noise 0.1 --methods knn posenet", "--room.seed 3"]


def test_a_run_is_set_beside_the_latest_that_differs_in_one_group(tmp_path: Path):
    other = make_run(tmp_path, {"encoder.step_noise": 0.2}, 0.3, age_s=60)
    make_run(tmp_path, {"encoder.step_noise": 0.2, "room.seed": 3}, 0.1, age_s=30)
    own = tmp_path / "runs" / "tiny" / make_run(tmp_path, {"encoder.step_noise": 0.1, "methods": ["knn"]}, 0.2)
    assert compare_with_latest(own) == (
        f"Beside {other} (in brackets): --encoder.step-noise 0.1 (0.2). RMS, median [cm]: Nearest neighbour 20.0, 2.0 "
        "(30.0, 2.0)."
    )
    assert compare_with_latest(own.parent / other) is not None
    make_run(tmp_path / "elsewhere", {}, 0.1)
    assert compare_with_latest(next((tmp_path / "elsewhere").glob("runs/tiny/seed*"))) is None


def test_a_run_without_truth_is_listed_as_such_with_the_time_of_its_figures(tmp_path: Path):
    name = make_run(tmp_path, {}, age_s=90000)
    write_json(tmp_path / "runs" / "tiny" / name / TRUTHLESS_METRICS, {"methods": {}})
    done = deepgps_here("runs", cwd=tmp_path)
    line = done.stdout.splitlines()[1]
    assert [cell for cell in line.split("  ") if cell][1:4:2] == ["0 s", "no truth"]
    assert describe_work(tmp_path / "runs" / "tiny" / name).endswith(", measured")


def test_what_cannot_be_read_is_said_and_the_others_are_listed(tmp_path: Path):
    make_run(tmp_path, {})
    broken = tmp_path / "runs" / "tiny" / make_run(tmp_path, {"seed": 1})
    (broken / "scenario.yaml").write_text("nonsense: 1")
    done = deepgps_here("runs", "runs/tiny", cwd=tmp_path)
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 4
    assert "cannot be read: " in done.stdout


@pytest.mark.parametrize("metrics", ["{}", '{"methods": []}', '{"methods": {"knn": {}}}', '{"methods": {"knn": null}}'])
def test_a_run_with_damaged_figures_is_listed_as_such(metrics: str, tmp_path: Path):
    names = [make_run(tmp_path, {}, 0.041, age_s=90), make_run(tmp_path, {"seed": 1}, 0.041)]
    (tmp_path / "runs" / "tiny" / names[1] / "metrics.json").write_text(metrics)
    done = deepgps_here("runs", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    _, whole, damaged, _ = done.stdout.splitlines()
    assert "Nearest neighbour 4.1 (2.0)" in whole
    assert damaged.startswith(f"tiny/{names[1]}")
    assert damaged.endswith("metrics.json is damaged: it does not list the errors of methods")


@pytest.mark.parametrize(("folder", "says"), [("nowhere", "nowhere does not exist"), (".", ". holds no runs")])
def test_nothing_to_list(folder, says, tmp_path):
    done = deepgps_here("runs", folder, cwd=tmp_path)
    assert (done.returncode, says in done.stderr) == (2, True)


def test_a_file_with_two_names_takes_its_disk_once(tmp_path):
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "images.npy").write_bytes(bytes(1000))
    (tmp_path / "shared.npy").hardlink_to(tmp_path / "drive" / "images.npy")
    (tmp_path / "own.npy").write_bytes(bytes(20))
    assert measure_disk(tmp_path) == 1020


def test_a_folder_with_the_name_of_a_file_is_no_run(tmp_path):
    (tmp_path / "other" / "scenario.yaml").mkdir(parents=True)
    assert list_runs(tmp_path) == []


def test_a_scenario_of_another_name_differs_from_the_defaults():
    assert list_differences(Scenario(name="mine", seed=3)) == {"seed": 3}
    assert list_differences(load_scenario("paper", {})) == {}
    assert list_differences(load_scenario("corridor", {"room.look_alike": "false"})) == {"room.look_alike": False}


def test_ages():
    assert [write_age(seconds) for seconds in (0.4, 59, 60, 7199, 90000)] == ["0 s", "59 s", "1 min", "1 h", "1 d"]


def test_the_table_needs_no_torch():
    import subprocess

    code = "import sys, deepgps.runs.run_table; print({'torch', 'mujoco', 'rerun'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
