"""A small study for tests, run for real by the command: its files, its process, and how to wait for it."""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import yaml

from deepgps.progress import Report
from deepgps.studies.engine.worker import Failures, do_run
from deepgps.studies.study import Plan
from tests.deepgps.test_cli import drop_progress

SCENARIO = """
room: {kind: bedroom, width_m: 3.2, depth_m: 2.8}
camera: {rings: 8, sectors: 32, face_px: 16}
drive: {samples: 60}
grid: {spacing_m: 0.5, headings: 2}
learn: {train: {steps: 20, segments: 4, samples: 4}, network: {width: 16}, fold: {restarts: 0}}
"""
STUDY = {
    "scenario": "mini.yaml",
    "methods": ["deepgps"],
    "cases": [{"learn.start": "auto", "learn.seed": 0}, {"learn.start": "random", "learn.seed": 1}],
    "report": "seeds",
    "target": {"unfolded": 1.0},
}


def write_study(folder: Path, **changes: object) -> Path:
    """Write the scenario and the study beside it."""
    (folder / "mini.yaml").write_text(SCENARIO)
    (folder / "mine.yaml").write_text(yaml.safe_dump({**STUDY, **changes}))
    return folder / "mine.yaml"


def start(study: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    """Start the command on a study, in a process group of its own."""
    command = [sys.executable, "-m", "deepgps.cli", "study", str(study), "--out", str(out), *more]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=out.parent
    )


def finish(process: subprocess.Popen[str]) -> str:
    """Wait for a command that does its work without complaint; returns what it said."""
    said, errors = process.communicate(timeout=120)
    assert (process.returncode, drop_progress(errors)) == (0, [])
    return said


def wait_until(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    """Wait for something that a running process brings about."""
    end = time.monotonic() + 60
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)


def run_all_here(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Do the runs of a study in this process, one after another, in place of an engine."""
    found = {plan.run: do_run(plan.scenario, folder / "runs" / plan.run, plan.recording, progress) for plan in plans}
    return {run: failure for run, failure in found.items() if failure}
