"""The reports beside the paper's figures: the studies behind them, and small runs of their worlds to the last file."""

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from deepgps.config.scenario import load_scenario
from deepgps.run import run
from deepgps.runs.run_folder import VIEWED
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.from_runs import add_labels, add_scans
from deepgps.studies.reports.pictures import draw_fields
from deepgps.studies.reports.record import Fields
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from deepgps.viewer.stream import open_rrd
from sim.errors import InputError
from sim.files.checksums import read_json
from tests.helpers.blueprints import read_error_field

SHORT_TRAINING = ("learn.train.steps=20", "learn.train.segments=4", "learn.network.width=16", "learn.fold.restarts=0")
LIDAR = ("lidar.rays=32", "lidar.headings=2", "drive.samples=400", "grid.spacing_m=0.25", "grid.headings=2")
FEATURES = ("learn.features.rings=4", "learn.features.principal=32", "learn.features.components=16")
PCA = ("learn.pca.headings=5",)


def make_small(world: str, methods: list[str], folder: Path, *settings: str) -> Path:
    changes = dict(setting.split("=") for setting in (*SHORT_TRAINING, *settings))
    run(load_scenario(world, {**changes, "methods": methods}), folder, fresh=False, progress=ignore)
    return folder


def test_methods_and_settings_are_refused_in_worlds_without_what_they_need():
    for world, settings, field in (
        ("landmarks", {"tag_camera.mounted": "true"}, "tag_camera.mounted"),
        ("landmarks", {"grid.held_out": "5"}, "grid.held_out"),
        ("living_room", {"methods": ["pca_knn"]}, "pca_knn"),
        ("quick", {"sensor": "lidar", "learn.network.architecture": "resnet"}, "'resnet' needs images"),
        ("lidar", {"methods": ["explicit"]}, "explicit needs distances to landmarks"),
    ):
        with pytest.raises(InputError, match=field):
            load_scenario(world, settings)
    assert load_scenario("living_room", {"methods": ["pca_knn"], "sensor": "lidar"}).sensor == "lidar"


@pytest.mark.slow
def test_every_method_of_lidar_runs_to_the_viewer_and_its_columns_add_up(tmp_path: Path):
    methods = ["deepgps", "posenet", "knn", "pca_knn"]
    folder = make_small("lidar", methods, tmp_path / "run", *LIDAR, *FEATURES, *PCA)
    with np.load(folder / "error_field.npz") as field:
        for method in methods:
            error = np.linalg.norm(field[method] - field["truth"][:, None], axis=-1)
            shown = np.linalg.norm(np.subtract(*read_error_field(folder / VIEWED, method)), axis=1)
            assert np.allclose(np.sort(shown), np.sort(error.max(axis=1)), atol=1e-5)
            own = add_scans(folder, {"method": method})
            assert own["each_rms_m"] == pytest.approx(np.sqrt((error**2).mean()))
            stored = [tensor.size for tensor in load_file(folder / method / "weights.safetensors").values()]
            assert own["stored"] == sum(stored)
            assert own["each_max_m"] == read_json(folder / "metrics.json")["methods"][method]["max_m"]
    assert any(chunk.entity_path.endswith("/scan") for chunk in open_rrd(folder / VIEWED).stream())


@pytest.mark.slow
def test_errors_of_the_lab_against_labels_and_truth_can_be_computed_again(tmp_path: Path):
    (plan,) = plan_runs(load_study("lab", tiny=True))
    kept = plan.scenario.tag_camera.model_copy(update={"kept": True})
    folder = tmp_path / "runs" / "one"
    run(plan.scenario.model_copy(update={"tag_camera": kept}), folder, fresh=False, progress=ignore)
    metrics = read_json(folder / "metrics.json")
    for name, group in (("error_field.npz", lambda one: one), ("label_field.npz", lambda one: one["against_labels"])):
        with np.load(folder / name) as field:
            for method in plan.scenario.methods:
                error = np.linalg.norm(field[method] - field["truth"][:, None], axis=-1).max(axis=1)
                assert group(metrics["methods"][method])["rms_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
                assert group(metrics["methods"][method])["max_m"] == pytest.approx(error.max())
    labels = metrics["labels"]
    assert 0 <= labels["unlabelled"] < 120 and 0 <= labels["test_unlabelled"] < 30
    assert labels["median_m"] < 0.01 and metrics["test"] == {"held_out": True, "headings": 1}
    row = {"method": "registration_distances", "run": "one", "seed": plan.scenario.seed, "rms_m": 1.0}
    columns = add_labels(folder, row)
    assert columns["labels_rms_m"] == labels["rms_m"] and columns["unlabelled"] == labels["unlabelled"]
    places = draw_fields(Fields("method"), [{**row, "median_m": 0.1}], ["seed"], tmp_path)
    assert places.axes[0].get_title().startswith("Registration, distances")
    paths = {str(chunk.entity_path) for chunk in open_rrd(folder / VIEWED).stream()}
    assert {"/world/error_field/registration_distances/accepted/arrows", "/drive/fisheye", "/drive/tag_camera"} <= paths
