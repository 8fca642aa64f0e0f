"""A small study for tests, run for real: its files, and how to do it, in a process of its own or in this one."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from deepgps.studies.engine.engine import RunAll, carry_out, claim_study, find_missing
from deepgps.studies.engine.pool import Failures
from deepgps.studies.engine.runs import do_run
from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.reports.report import report_study
from deepgps.studies.study import load_study
from deepgps.terminal.progress import Report, ignore
from tests.helpers.command import drop_progress

LEARN = "learn: {train: {steps: 20, segments: 4, samples: 4}, network: {width: 16}, fold: {restarts: 0}}"
SCENARIO = f"""
room: {{kind: bedroom, width_m: 3.2, depth_m: 2.8}}
camera: {{rings: 8, sectors: 32, face_px: 16}}
drive: {{samples: 60}}
grid: {{spacing_m: 0.5, headings: 2}}
{LEARN}
"""
PLANE = f"""
world: landmarks
landmarks: {{count: 20, segments: 12}}
drive: {{spacing_m: 0.05, samples: 60}}
grid: {{spacing_m: 0.5, headings: 2}}
{LEARN}
"""
"""A world that is recorded in no time, for what has nothing to do with rooms and renderers."""
STUDY = {
    "scenario": "mini.yaml",
    "methods": ["deepgps"],
    "cases": [{"learn.start": "auto", "learn.seed": 0}, {"learn.start": "random", "learn.seed": 1}],
    "report": "rooms",
    "target": {"deepgps_max_m": 9.0},
}


def write_study(folder: Path, **changes: object) -> Path:
    """Write the scenarios, ``mini.yaml`` and ``plane.yaml``, and the study beside them."""
    (folder / "mini.yaml").write_text(SCENARIO)
    (folder / "plane.yaml").write_text(PLANE)
    (folder / "mine.yaml").write_text(yaml.safe_dump({**STUDY, **changes}))
    return folder / "mine.yaml"


def start(study: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    """Start the command on a study, in a process group of its own."""
    command = [sys.executable, "-m", "deepgps.commands.main", "study", str(study), "--out", str(out), *more]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=out.parent
    )


def finish(process: subprocess.Popen[str]) -> str:
    """Wait for a command that does its work without complaint; returns what it said."""
    said, errors = process.communicate(timeout=120)
    assert (process.returncode, drop_progress(errors)) == (0, [])
    return said


def run_all_here(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Do the runs of a study in this process, one after another, in place of an engine."""
    found = {plan.run: do_run(plan.scenario, folder / "runs" / plan.run, plan.recording, progress) for plan in plans}
    return {run: failure for run, failure in found.items() if failure}


def do_here(path: Path, out: Path, run_all: RunAll = run_all_here) -> Failures:
    """Do a study as the command does, with an engine of the test's choice, and report it."""
    study = load_study(str(path), tiny=False)
    plans = plan_runs(study)
    with claim_study(study, out, fresh=False) as place:
        failures = carry_out(plans, find_missing(plans, place, ignore), place, run_all, ignore)
        report_study(study, plans, failures, place)
    return failures
