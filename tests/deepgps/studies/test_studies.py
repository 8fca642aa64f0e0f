"""A study run for real, small: killed, interrupted, finished, grown; and its errors by their text."""

import os
import re
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml

from deepgps.config.scenario import Scenario, load_scenario
from deepgps.runs.collect import make_recording
from deepgps.runs.inputs import digest, digest_recording
from deepgps.studies.engine.engine import claim_study, find_missing, find_place
from deepgps.studies.engine.pool import Failures
from deepgps.studies.engine.recordings import find_drives, list_undriven
from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.study import load_study
from deepgps.studies.table import gather, varied_in
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError, WorkError
from sim.files.checksums import read_json, write_arrays, write_json
from sim.recording.format import check_recording
from tests.helpers.command import deepgps_here, drop_progress, wait_until
from tests.helpers.small_study import STUDY, do_here, run_all_here, start, write_study

MORE_CASES = [{"learn.start": "auto", "learn.seed": 2}, {"learn.train.device": "cuda:99", "learn.seed": 3}]
INTERRUPTED = "interrupted; the same command continues where it stopped"


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, Path, str]:
    """A study killed while it recorded, interrupted in its runs, and finished: file, folder, what it said."""
    home = tmp_path_factory.mktemp("study")
    study, out = write_study(home), home / "out"
    process = start(study, out)
    # a busy machine may look only after the recording is finished
    wait_until(
        lambda: [*out.glob("recordings/*.collecting/drive-*.npz"), *out.glob("recordings/*/manifest.json")], process
    )
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    process = start(study, out)
    wait_until(lambda: list(out.glob("runs/*/scenario.yaml")), process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the children as well
    said = process.communicate(timeout=60)[1]
    assert (process.returncode, drop_progress(said)) == (130, [INTERRUPTED])
    process = start(study, out)
    said, errors = process.communicate(timeout=120)
    assert (process.returncode, drop_progress(errors)) == (0, [])
    return study, out, said


@pytest.fixture(scope="module")
def grown(finished) -> tuple[Path, str, str, dict[Path, int]]:
    """The same with a run more and one that fails: folder, what it said, its errors, when older files were written."""
    study, out, _ = finished
    write_study(study.parent, cases=[*STUDY["cases"], *MORE_CASES])
    times = {path: path.stat().st_mtime_ns for path in out.glob("r*/*/*") if path.is_file() and path.name != ".deepgps"}
    process = start(study, out, "--publish", str(out.parent / "pages"))
    said, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    return out, said, errors, times


@pytest.mark.slow
def test_a_study_killed_and_interrupted_finishes_with_one_recording_a_table_and_its_target(finished):
    _, out, said = finished
    (recording,) = out.glob("recordings/*")
    rows = pq.read_table(out / "table.parquet").to_pylist()
    assert [(row["learn.start"], row["learn.seed"], row["failure"]) for row in rows] == [
        ("auto", 0, None),
        ("random", 1, None),
    ]
    for row in rows:
        run = out / "runs" / row["run"]
        assert not (run / "recording").readlink().is_absolute()
        assert (run / "recording").resolve() == recording.resolve()
        metrics = read_json(run / "metrics.json")["methods"]["deepgps"]
        assert (row["rms_m"], row["failure"]) == (metrics["rms_m"], None) and 0.0 <= metrics["flipped"] <= 0.5
        assert set(metrics["fold"]) >= {"found", "length_error_fraction", "overlap_fraction"}
    text = (out / "table.md").read_text()
    assert text in said and "deepgps view" in said
    assert "DeepGPS, max" in text and "<= 900.0 cm" in text
    assert (out / "figures" / "rooms.png").is_file() and not list(out.rglob("*.part"))
    assert yaml.safe_load((out / "study.yaml").read_text())["methods"] == ["deepgps"]


@pytest.mark.slow
def test_a_study_that_grows_runs_only_what_is_missing_and_lists_what_fails(grown):
    out, said, errors, times = grown
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert (len(list(out.glob("runs/*/metrics.json"))), len(list(out.glob("recordings/*")))) == (3, 1)
    assert drop_progress(errors) == [f"failed: 1 of 4 runs failed; {out / 'table.md'} says why"]
    rows = pq.read_table(out / "table.parquet").to_pylist()
    assert [row["failure"] is None for row in rows] == [True, True, True, False]
    assert "cuda:99" in rows[3]["failure"] and rows[3]["failure"] in said
    assert "4 runs of" in said and "not copied to" in said and not (out.parent / "pages").exists()


def test_a_recording_is_shared_by_what_does_not_change_it(tmp_path):
    axes = {"learn.seed": [0, 1], "encoder.step_noise": [0.0, 0.1]}
    plans = plan_runs(load_study(str(write_study(tmp_path, cases=[{}], axes=axes, seeds=[0, 5])), tiny=False))
    assert len({plan.run for plan in plans}) == 8
    assert len({plan.recording for plan in plans}) == 4
    assert {plan.scenario.seed for plan in plans} == {0, 5}
    assert {plan.scenario.methods for plan in plans} == {("deepgps",)}


def test_tiny_replaces_only_what_it_names(tmp_path):
    tiny = {"cases": [{"room.seed": 3}], "set": {"drive.samples": 32}}
    study = load_study(str(write_study(tmp_path, set={"grid.headings": 3}, tiny=tiny)), tiny=True)
    (plan,) = plan_runs(study)
    assert (study.name, study.target) == ("mine-tiny", {})
    assert (plan.scenario.room.seed, plan.scenario.drive.samples, plan.scenario.grid.headings) == (3, 32, 3)


def test_groups_given_as_mappings_set_what_they_name_in_every_part_of_a_study(tmp_path):
    parts = {
        "set": {"drive": {"samples": 40, "spacing_m": 0.1}, "grid.headings": 3},
        "cases": [{"drive": {"longest_m": 2.0}}, {"drive": {"longest_m": 3.0, "samples": 50}}],
        "axes": {"camera": [{"rings": 16}, {"rings": 4}]},
        "tiny": {"set": {"drive": {"samples": 32}}},
    }
    path = str(write_study(tmp_path, **parts))
    whole, tiny = (plan_runs(load_study(path, is_tiny)) for is_tiny in (False, True))
    drives = [(run.drive.samples, run.drive.spacing_m, run.drive.longest_m) for run in (p.scenario for p in whole)]
    assert drives == [(40, 0.1, 2.0)] * 2 + [(50, 0.1, 3.0)] * 2
    assert [(plan.scenario.camera.rings, plan.scenario.camera.sectors) for plan in whole] == [(16, 32), (4, 32)] * 2
    assert [plan.scenario.drive.samples for plan in tiny] == [32, 32, 50, 50]
    assert {plan.scenario.grid.headings for plan in whole} == {3}


def test_full_replaces_only_what_it_names_and_keeps_the_target_and_a_file_names_its_study(tmp_path):
    full = {"set": {"learn.train.steps": 50}, "seeds": [0, 1]}
    path = write_study(tmp_path, cases=[{}], set={"grid.headings": 3}, full=full)
    study = load_study(str(path), tiny=False, full=True)
    assert (study.name, study.target) == ("mine-full", {"deepgps_max_m": 9.0})
    assert {plan.scenario.learn.train.steps for plan in plan_runs(study)} == {50}
    assert [(plan.scenario.seed, plan.scenario.grid.headings) for plan in plan_runs(study)] == [(0, 3), (1, 3)]
    with pytest.raises(InputError, match="--tiny and --full exclude each other"):
        load_study(str(path), tiny=True, full=True)
    with pytest.raises(InputError, match="study mine has no long version"):
        load_study(str(write_study(tmp_path)), tiny=False, full=True)
    for file, name in (("my study", "my_study"), ("x" * 80, "x" * 64)):
        path = str(write_study(tmp_path, full={}).rename(tmp_path / f"{file}.yaml"))
        assert load_study(path, tiny=False).name == name
        assert load_study(path, tiny=True).name == f"{name[:59]}-tiny"


def test_a_case_may_name_its_own_scenario(tmp_path):
    cases = [{"scenario": "landmarks", "drive.samples": 500}, {}]
    study = write_study(tmp_path, cases=cases, axes={"encoder.step_noise": [0.0, 0.1]})
    plans = plan_runs(load_study(str(study), tiny=False))
    assert [plan.scenario.name for plan in plans] == ["landmarks"] * 2 + ["mini"] * 2
    rows = gather(plans, {plan.run: "not run" for plan in plans}, tmp_path)
    assert [row["scenario"] for row in rows] == ["landmarks"] * 2 + ["mini"] * 2
    assert set(varied_in(rows[0])) == {"scenario", "drive.samples", "encoder.step_noise"}
    assert varied_in(rows[0])[-1] == "encoder.step_noise"  # the axis


def test_a_case_may_name_its_own_methods(tmp_path):
    study = write_study(tmp_path, cases=[{"room.seed": 1}, {"room.seed": 2, "methods": ["knn", "posenet"]}], axes={})
    plans = plan_runs(load_study(str(study), tiny=False))
    assert {plan.scenario.methods for plan in plans if plan.varied["room.seed"] == 1} == {("deepgps",)}
    assert {plan.scenario.methods for plan in plans if plan.varied["room.seed"] == 2} == {("knn", "posenet")}
    rows = gather(plans, {plan.run: "not run" for plan in plans}, tmp_path)
    assert {(row["room.seed"], row["method"]) for row in rows} == {(1, "deepgps"), (2, "knn"), (2, "posenet")}
    assert "methods" not in rows[0]


def test_a_scenario_that_varies_is_sought_beside_the_study_as_its_own_is(tmp_path):
    (tmp_path / "other.yaml").write_text("drive: {samples: 50}")
    varied = {"cases": [{}], "axes": {"scenario": ["other.yaml"]}}
    whole = load_study(str(write_study(tmp_path, **varied)), tiny=False)
    tiny = load_study(str(write_study(tmp_path, tiny={"cases": [{"scenario": "other.yaml"}]})), tiny=True)
    for (plan,) in (plan_runs(whole), plan_runs(tiny)):
        assert (plan.scenario.name, plan.scenario.drive.samples) == ("other", 50)


def test_two_scenarios_of_one_name_are_refused(tmp_path):
    for folder, samples in (("one", 50), ("other", 60)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "room.yaml").write_text(f"drive: {{samples: {samples}}}")
    axes = {"scenario": ["one/room.yaml", "other/room.yaml"]}
    study = load_study(str(write_study(tmp_path, cases=[{}], axes=axes)), tiny=False)
    with pytest.raises(InputError, match=r"one/room.yaml and .*other/room.yaml have the same name, room; set name in"):
        plan_runs(study)
    (tmp_path / "other" / "room.yaml").write_text("name: other\ndrive: {samples: 60}")
    assert [plan.scenario.name for plan in plan_runs(study)] == ["room", "other"]
    two_paths = [{}, {"scenario": str(tmp_path / "one" / ".." / "mini.yaml"), "learn.seed": 1}]
    assert len(plan_runs(load_study(str(write_study(tmp_path, cases=two_paths)), tiny=False))) == 2


def test_a_drive_is_made_once_as_its_longest_recording_without_faults(tmp_path):
    axes = {"encoder.step_noise": [0.1, 0.0], "drive.samples": [40, 60]}
    plans = plan_runs(load_study(str(write_study(tmp_path, cases=[{}], axes=axes, seeds=[0, 5])), tiny=False))
    drives = find_drives(plans)
    assert len(drives) == 8
    assert {digest_recording(drive) for drive in drives.values()} == {plan.recording for plan in (plans[6], plans[7])}
    for plan in plans:
        drive = drives[plan.recording]
        assert (drive.seed, drive.drive.samples, drive.encoder.step_noise) == (plan.scenario.seed, 60, 0.0)


@pytest.mark.slow
def test_recordings_that_differ_in_deployment_share_the_training_drive(tmp_path):
    cases = [{}, {"deployment.light": 0.5}, {"grid.spacing_m": 0.6}]
    exact = {"encoder.slip_per_m": 0, "encoder.ticks_per_rev": 4096}  # else each is derived from a drive of its own
    study = {"scenario": "tiny", "methods": ["knn"], "set": {"drive.samples": 60, "grid.spacing_m": 0.8, **exact}}
    path = write_study(tmp_path, **study, cases=cases, axes={}, target={}, report="plain")
    assert do_here(path, tmp_path / "out") == {}
    made = sorted((tmp_path / "out" / "recordings").iterdir())
    assert len(made) == len(cases)
    assert len({(folder / "observations" / "fisheye.npy").stat().st_ino for folder in made}) == 1
    assert len({(folder / "test" / "fisheye.npy").stat().st_ino for folder in made}) == len(cases)
    for folder in made:
        check_recording(folder)


def test_a_study_looks_only_where_a_run_or_its_recording_is_missing(tmp_path):
    axes = {"learn.seed": [0, 1], "encoder.step_noise": [0.0, 0.1]}
    study = load_study(str(write_study(tmp_path, cases=[{}], axes=axes, seeds=[0, 5], target={})), tiny=False)
    plans = plan_runs(study)

    def list_seeds(fresh: bool = False) -> list[int]:
        place = find_place(tmp_path, fresh)
        return [one.seed for one in list_undriven(plans, find_missing(plans, place, ignore), place)]

    assert list_seeds() == [0, 5]
    drive = next(plan for plan in plans if plan.scenario.seed == 0 and plan.scenario.encoder.step_noise == 0.0)
    write_json(tmp_path / "recordings" / drive.recording / "manifest.json", {})
    assert list_seeds() == [5], "that with noise is derived"
    for plan in plans:
        if plan.scenario.seed == 5:
            write_json(tmp_path / "runs" / plan.run / "metrics.json", {})
            write_arrays(tmp_path / "runs" / plan.run / "error_field.npz", {})
    assert list_seeds() == []
    (tmp_path / "study.yaml").touch()
    assert set(list_seeds(fresh=True)) == {0, 5}


@pytest.mark.slow
def test_cut_off_among_derived_recordings_only_what_is_missing_is_made(tmp_path):
    def do_one(plans: Sequence[Plan], place: Path, progress: Report) -> Failures:
        run_all_here(plans[:1], place, progress)
        raise KeyboardInterrupt

    axes = {"encoder.step_noise": [0.0, 0.1], "drive.samples": [40, 60]}
    changes = {"scenario": "plane.yaml", "cases": [{}], "axes": axes, "target": {}}
    study, out = write_study(tmp_path, **changes), tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        do_here(study, out, do_one)
    derived = [path for path in out.glob("recordings/*/manifest.json") if "derived_from" in read_json(path)]
    assert len(derived) == 3
    (done,) = [(path.parent / "recording").resolve() for path in out.glob("runs/*/metrics.json")]
    needed = next(path for path in derived if path.parent.resolve() != done)
    needed.unlink()  # as if it had been killed just then
    made = {path: path.stat().st_mtime_ns for path in out.glob("r*/*/m*.json")}
    assert len(made) == 4
    assert do_here(study, out) == {}
    assert {path: path.stat().st_mtime_ns for path in made} == made
    for path in out.glob("recordings/*"):
        check_recording(path)


@pytest.mark.slow
def test_a_drive_that_fails_fails_its_runs_and_no_others(tmp_path, monkeypatch):
    def fail_in_rooms(scenario: Scenario, *more: Any) -> None:
        if scenario.world == "room":
            raise WorkError("stuck between\ntwo chairs")
        make_recording(scenario, *more)

    monkeypatch.setattr("deepgps.studies.engine.recordings.make_recording", fail_in_rooms)
    changes = {"cases": [{}, {"scenario": "plane.yaml"}], "axes": {"encoder.step_noise": [0.0, 0.1]}, "target": {}}
    failures = do_here(write_study(tmp_path, **changes, report="plain"), tmp_path / "out")
    assert len(failures) == 2
    rows = pq.read_table(tmp_path / "out" / "table.parquet").to_pylist()
    assert [row["failure"] for row in rows] == ["recording: stuck between two chairs"] * 2 + [None] * 2


WRONG_STUDIES: list[tuple[dict, str]] = [
    ({"seedz": [0]}, "seedz"),
    ({"seeds": [], "report": "fancy"}, "seeds []"),
    ({"seeds": ["a"], "report": "fancy"}, "report 'fancy'"),
    ({"seeds": [True, 0]}, "seeds [True, 0]"),
    ({"target": {"train_s": True}}, "target {'train_s': True}"),
    ({"axes": {"encoder.slip_per_m": [0.1, True]}}, "encoder.slip_per_m True"),
    ({"set": {"drive.samples": 50, "drive": {"samples": 60}}}, "drive.samples: given twice, as 60 and 50"),
    ({"axes": {"learn.lift": [{"dimensions": 3}], "learn.lift.dimensions": [4]}}, "learn.lift.dimensions: given"),
    ({"cases": [{"room": {"seed": 1}}], "axes": {"room.seed": [2]}}, "room.seed is both in cases and in axes"),
    ({"cases": [3]}, "cases.0 3"),
    ({"cases": [{"seed": 3}]}, "seed can be no name"),
    ({"axes": {"room.seed": []}}, "axes.room.seed"),
    ({"target": {"rms": 1}}, "rms is no figure of the report rooms, which has {method}_rms_m"),
    ({"tiny": {"casez": []}}, "tiny.casez"),
    ({"full": {"casez": []}}, "full.casez"),
    ({"scenario": "nowhere"}, "scenario 'nowhere'"),
    ({"set": {"room.sed": 3}}, "room.sed"),
    ({"cases": [{"drive.samples": 1}, {"grid.headings": 0}]}, "; grid.headings 0"),
    ({"cases": [{}, {"learn.start": "auto"}]}, "two runs are the same"),
    ({"cases": [{"scenario": "nowhere"}]}, "scenario 'nowhere'"),
    ({"cases": [{"scenario": 3}]}, "scenario 3"),
    ({"report": "curves", "target": {}, "axes": {"room.kind": ["office"]}}, "report curves needs numbers"),
    ({"report": "change", "target": {}}, "report change needs drive.mixed_light"),
    *(
        ({"report": "diagnose", "target": {}, "cases": [{}], **changes}, f"drive.samples .*{given}")
        for changes, given in (
            ({}, "None"),
            ({"set": {"drive.samples": "many"}}, "'many'"),
            ({"set": {"drive.samples": 300}, "axes": {"drive.samples": [300, 400]}}, "in set alone"),
        )
    ),
]


def test_wrong_studies_are_named_in_one_line(tmp_path):
    for changes, words in WRONG_STUDIES:
        with pytest.raises(InputError) as caught:
            plan_runs(load_study(str(write_study(tmp_path, **changes)), tiny=False))
        said = str(caught.value)
        assert words in said or re.search(words, said), (changes, said)
        assert "\n" not in said


def test_runs_are_counted_before_any_is_planned(tmp_path):
    axes = {name: list(range(1000)) for name in ("room.seed", "drive.samples", "learn.seed")}
    study = load_study(str(write_study(tmp_path, cases=[{}], axes=axes)), tiny=False)
    with pytest.raises(InputError) as caught:
        plan_runs(study)
    assert str(caught.value) == "study mine has 1000000000 runs; a study has at most 10000"


def test_many_runs_are_planned_as_one_by_one_and_progress_is_told(tmp_path):
    axes = {"encoder.step_noise": [number / 1000 for number in range(100)]}
    study = load_study(str(write_study(tmp_path, cases=[{}], axes=axes, seeds=[0, 1, 2, 3, 4])), tiny=False)
    told = []
    plans = plan_runs(study, lambda label, done, total, look=None: told.append((label, done, total)))
    assert told == [("plan", done, 500) for done in range(0, 501, 100)]
    assert len({plan.run for plan in plans}) == 500
    last = plans[-1]
    assert (last.run, last.recording) == (digest(last.scenario), digest_recording(last.scenario))
    one = load_scenario(study.scenario, {**study.set, **last.varied, "methods": study.methods, "seed": 4})
    assert last.scenario == one


def test_of_many_wrong_runs_the_first_problems_are_named(tmp_path):
    axes = {"room.kind": [f"k{number}" for number in range(100)]}
    with pytest.raises(InputError) as caught:
        plan_runs(load_study(str(write_study(tmp_path, cases=[{}], axes=axes)), tiny=False))
    assert "room.kind 'k4': must be" in str(caught.value)
    assert "k5" not in str(caught.value)
    assert str(caught.value).endswith("; and 95 more")


def test_a_folder_that_is_no_study_is_not_touched(tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    done = deepgps_here("study", str(write_study(tmp_path)), "--out", str(tmp_path / "other"), cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: --out {tmp_path / 'other'} is neither empty nor a study folder")
    assert done.stderr.count("\n") == 1
    assert (tmp_path / "other" / "thesis.txt").read_text() == "mine"


def test_a_folder_of_another_study_is_replaced_by_fresh_alone(tmp_path):
    out, study = tmp_path / "out", load_study(str(write_study(tmp_path)), tiny=False)
    with claim_study(study, out, fresh=False):
        pass
    before = (out / "study.yaml").read_bytes()
    for changes, name in (
        ({"scenario": "plane.yaml", "cases": [{}]}, "mine of .*pla"),
        ({"name": "other"}, "other of"),
    ):
        other = load_study(str(write_study(tmp_path, **changes)), tiny=False)
        with (
            pytest.raises(InputError, match=f"holds the study mine of the scenario .*mini.yaml, not {name}"),
            claim_study(other, out, fresh=False),
        ):
            pass
        assert (out / "study.yaml").read_bytes() == before
    with claim_study(other, out, fresh=True):
        pass
    assert (out / "study.yaml").read_bytes() != before


def test_a_study_that_has_grown_or_moved_continues_in_its_folder(tmp_path):
    (tmp_path / "moved").mkdir()
    for folder, seeds in ((tmp_path, [0]), (tmp_path, [0, 1]), (tmp_path / "moved", [0, 1])):
        with claim_study(load_study(str(write_study(folder, seeds=seeds)), tiny=False), tmp_path / "out", fresh=False):
            pass
        assert yaml.safe_load((tmp_path / "out" / "study.yaml").read_text())["seeds"] == seeds
    (tmp_path / "out" / "study.yaml").write_text("damaged: [")
    with claim_study(load_study(str(write_study(tmp_path)), tiny=False), tmp_path / "out", fresh=False):
        pass
