"""``deepgps track`` on a small run with a deployment drive: what it writes, what it says, and what it refuses."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from deepgps.api.run import load
from deepgps.evaluation.deployment import open_deployment
from deepgps.evaluation.measure_run import read_measured
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.runs.owned_folder import hold
from deepgps.runs.run_folder import RUN
from deepgps.tracking.track import PATHS, read_track
from sim.files.checksums import read_json, write_json
from sim.recording.format import DEPLOYMENT_MANIFEST, open_recording, open_truth
from sim.recording.turns import NO_IMAGE
from tests.helpers.command import deepgps_here
from tests.helpers.made_once import make_once


@pytest.fixture(scope="module")
def run(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shared run, tracked; ``said.txt`` beside it is what the command printed."""

    def make(folder: Path) -> None:
        shutil.copytree(finished_run, folder / "run")
        done = deepgps_here("track", "run", "--tum", "tum", cwd=folder)
        assert done.returncode == 0, done.stderr
        (folder / "said.txt").write_text(done.stdout)

    return make_once(tmp_path_factory, "tracked", make) / "run"


def test_files_and_figures_belong_together(run: Path):
    track, figures = (
        read_track(run / "tracking" / "deepgps_compass.npz"),
        read_json(run / "tracking/deepgps_compass.json"),
    )
    drive = open_deployment(open_recording(run / "recording"))
    assert drive is not None
    true, alignment = open_truth(drive.folder).pose, read_alignment(run / "deepgps_compass")
    seen = track.observation != NO_IMAGE
    for name in PATHS:
        error = np.hypot(*(alignment.apply(track.paths[name].pose[seen, :2]) - true[track.observation[seen], :2]).T)
        assert figures["paths"][name]["images"] == np.isfinite(error).sum()
        assert figures["paths"][name]["rms_m"] == pytest.approx(np.sqrt(np.nanmean(error**2)))
    assert figures["tracked"] == figures["images"] == 60
    assert (np.diff(track.time) > 0.0).all()
    assert track.probability[:, 0].max() <= 1.0
    assert (run / "tracking" / "deepgps_compass.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_said_names_every_path_and_the_causes_of_refused_images(run: Path):
    said, causes = (run.parent / "said.txt").read_text(), read_json(run / "tracking/deepgps_compass.json")["causes"]
    assert all(title in said for title in PATHS.values())
    assert "DeepGPS, compass: 60 of 60 images tracked" in said
    assert f"The deployment drive: {100 * causes['accepted']:.1f} % of images accepted" in said
    assert causes == read_json(run / "metrics.json")["methods"]["deepgps_compass"]["in_use"]["causes"]
    found = load(run).causes("deepgps_compass", run / "recording" / "use")
    assert found is not None and found.summarise() == causes and len(found.label) == 60
    assert {path.stem for path in (run.parent / "tum").iterdir()} == {*PATHS, "truth"}


def test_tracking_is_better_than_single_images(run: Path):
    paths = read_json(run / "tracking/deepgps_compass.json")["paths"]
    assert paths["smoothed"]["rms_m"] < paths["single"]["rms_m"]


def test_same_bytes_again(run: Path, tmp_path: Path):
    shutil.copytree(run, tmp_path / "run")
    before = (run / "tracking" / "deepgps_compass.npz").read_bytes()
    (tmp_path / "run" / "tracking" / "deepgps_compass.npz").unlink()
    assert deepgps_here("track", "run", cwd=tmp_path).returncode == 0
    assert (tmp_path / "run" / "tracking" / "deepgps_compass.npz").read_bytes() == before


def test_other_recordings_without_a_truth_are_tracked(run: Path, tmp_path: Path):
    shutil.copytree(run, tmp_path / "run")
    use, log = tmp_path / "run" / "recording" / "use", tmp_path / "log"
    shutil.copytree(use, log, ignore=shutil.ignore_patterns("truth", "scene.glb"))
    manifest = read_json(use / "manifest.json")
    sums = {name: one for name, one in manifest["sha256"].items() if (log / name).is_file()}
    write_json(log / "manifest.json", {**manifest, "sha256": sums, "log": {"start_ns": 1_700_000_000_000_000_000}})
    done = deepgps_here("track", "run", "--drive", "log", "--method", "knn", "--tum", "tum", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "The truth is not known" in done.stdout and "--tum writes poses in the world's frame" in done.stdout
    written = np.loadtxt(tmp_path / "tum" / "single.tum")
    assert written[0, 0] >= 1.7e9
    (stored,) = (tmp_path / "run" / "tracking").glob("knn-*.npz")
    track = read_track(stored)
    place = read_alignment(run / "knn").apply(track.paths["single"].pose[track.observation != NO_IMAGE, :2])
    np.testing.assert_allclose(written[:, 1:3], place[np.isfinite(place).all(axis=1)], atol=1e-6)
    (path,) = (tmp_path / "run" / "tracking").glob("knn-*.json")
    assert re.fullmatch(r"knn-[0-9a-f]{8}\.json", path.name)
    assert not path.with_suffix(".png").exists()
    figures = read_json(path)
    assert set(figures) == {"method", "images", "tracked", "accepted", "causes"}


@pytest.mark.parametrize("name", ["error_field.npz", "use_field.npz"])
def test_a_damaged_error_field_is_noticed(name: str, run: Path, tmp_path: Path):
    for file in ("metrics.json", "error_field.npz", "use_field.npz"):
        shutil.copy(run / file, tmp_path)
    assert read_measured(tmp_path) == read_json(run / "metrics.json")
    content = bytearray((tmp_path / name).read_bytes())
    for part in (3, 4, 5):  # one may be in a header that nobody reads
        content[len(content) // part] ^= 1
    (tmp_path / name).write_bytes(content)
    assert read_measured(tmp_path) is None
    (tmp_path / name).unlink()
    assert read_measured(tmp_path) is None


def edit(path: Path, change: Callable[[dict], None]) -> None:
    """Change a manifest in place."""
    manifest = read_json(path)
    change(manifest)
    write_json(path, manifest)


def test_what_cannot_be_tracked_is_refused_in_a_line_before_the_work(run: Path, tmp_path: Path):
    shutil.copytree(run, tmp_path / "run", ignore=shutil.ignore_patterns("tracking"))
    shutil.copytree(run / "recording" / "use", tmp_path / "log")
    edit(tmp_path / "log" / "manifest.json", lambda one: one["settings"]["camera"].update(field_of_view_deg=120.0))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "truth.tum").write_text("0 0 0 0 0 0 0 1\n")

    def refuse(message: str, *words: str) -> None:
        done = deepgps_here("track", *words, cwd=tmp_path)
        assert done.returncode == 2 and message in done.stderr and "Traceback" not in done.stderr, done.stderr

    refuse("nowhere does not exist", "nowhere")
    refuse("--method 'pca_knn': run has trained deepgps_compass, deepgps, posenet", "run", "--method", "pca_knn")
    refuse("is no finished recording", "run", "--drive", ".")
    refuse("camera.field_of_view_deg 120: the run has learned from images of 190", "run", "--drive", "log")
    with hold(tmp_path / "run", RUN):
        refuse("run is in use by another process", "run")
    refuse("deepgps did not write it", "run", "--tum", "mine")
    assert (tmp_path / "mine" / "truth.tum").read_text() == "0 0 0 0 0 0 0 1\n"
    shutil.rmtree(tmp_path / "run" / "tracking")
    edit(tmp_path / "run" / "recording" / "manifest.json", lambda one: one["sha256"].pop(DEPLOYMENT_MANIFEST))
    refuse("--deployment.drive-samples", "run")
    shutil.copy(run / "recording" / "manifest.json", tmp_path / "run" / "recording")
    (tmp_path / "run" / "deepgps_compass" / "alignment.json").unlink()
    refuse("has no alignment.json", "run")
    assert not (tmp_path / "run" / "tracking").exists()
