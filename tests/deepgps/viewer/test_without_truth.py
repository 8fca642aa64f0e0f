"""A recording without truth trains and is viewed, and what needs the truth says so in one line."""

import shutil
from pathlib import Path

import pytest

from deepgps.runs.run_folder import VIEWED
from deepgps.viewer.run import find_recording
from sim.recording.format import check_recording, finish_recording, open_recording, read_manifest
from tests.helpers.blueprints import count_rows
from tests.helpers.command import deepgps_here
from tests.helpers.synthetic_run import write_synthetic_run

SCENARIO = """
world: landmarks
landmarks: {segments: 40}
grid: {spacing_m: 0.5}
methods: [deepgps, posenet]
learn: {train: {steps: 20, segments: 4, samples: 4}, network: {width: 16}, fold: {restarts: 0}}
"""


def forget_truth(recording: Path) -> None:
    """Make a recording one of a robot that nobody has watched."""
    shutil.rmtree(recording / "truth")
    finish_recording(recording, read_manifest(recording).model_dump(by_alias=True))
    check_recording(recording)


def test_the_drive_and_the_maps_are_viewed(tmp_path: Path):
    run = write_synthetic_run(tmp_path / "run", samples=200)
    for name in ("metrics.json", "error_field.npz"):
        (run / name).unlink()
    forget_truth(run / "recording")
    assert find_recording(run) == run / VIEWED
    counts = count_rows(run / VIEWED)
    readings = len(open_recording(run / "recording").reading)
    assert counts["/world/drive/leg"] == readings > counts["/drive/ticks/left"]
    assert counts["/drive/fisheye"] > 1
    assert counts["/world/training/deepgps"] > 1
    assert not any("truth" in path or "error" in path for path in counts)


@pytest.mark.slow
def test_it_trains_and_what_needs_the_truth_says_so(tmp_path: Path):
    (tmp_path / "mine.yaml").write_text(SCENARIO)

    def call(command: str, *methods: str) -> tuple[int, str]:
        words = (command, "mine.yaml", "--methods", *methods, "--out", f"{'_'.join(methods)}")
        done = deepgps_here(*words, cwd=tmp_path)
        return done.returncode, done.stderr.splitlines()[-1] if done.stderr else ""

    for methods in (("deepgps",), ("posenet",)):
        assert call("collect", *methods)[0] == 0
        forget_truth(tmp_path / "_".join(methods) / "recording")
    assert call("train", "deepgps")[0] == 0
    assert (tmp_path / "deepgps" / "deepgps" / "positioner.json").is_file()
    assert call("evaluate", "deepgps")[0] == 0
    assert (tmp_path / "deepgps" / "without_truth.json").is_file()
    assert not (tmp_path / "deepgps" / "metrics.json").exists()
    code, said = call("train", "posenet")
    assert (code, "has no truth" in said) == (2, True), said
    assert find_recording(tmp_path / "deepgps").is_file()
