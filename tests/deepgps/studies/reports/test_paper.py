"""The reports beside the paper's figures: the studies behind them, and small runs of their worlds to the last file."""

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from deepgps.config.scenario import load_scenario
from deepgps.run import run
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports import paper
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from deepgps.viewer.read import open_rrd, read_error_field
from deepgps.viewer.run import RECORDING
from sim.errors import InputError
from sim.files.checksums import read_json

SHORT = ("learn.train.steps=20", "learn.train.segments=4", "learn.network.width=16", "learn.fold.restarts=0")
LANDMARKS = ("landmarks.count=40", "landmarks.segments=25", "landmarks.reach_m=1.2", "drive.spacing_m=0.05")
EXPLICIT = ("grid.spacing_m=0.25", "learn.explicit.readings=200", "learn.explicit.evaluations=20")
LIDAR = ("lidar.rays=32", "lidar.headings=2", "drive.samples=400", "grid.spacing_m=0.25", "grid.headings=2")
FEATURES = ("learn.features.rings=4", "learn.features.principal=32", "learn.features.components=16")
PCA = ("learn.pca.headings=5",)


def make_small(world: str, methods: list[str], folder: Path, *settings: str) -> Path:
    changes = dict(setting.split("=") for setting in (*SHORT, *settings))
    run(load_scenario(world, {**changes, "methods": methods}), folder, fresh=False, progress=ignore)
    return folder


def cells(text: str, *first: str) -> list[str]:
    """The cells of the one line that begins with these."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    (line,) = [line for line in lines if tuple(line[: len(first)]) == first]
    return line


def test_the_papers_figures_are_those_of_its_tables():
    landmarks, lab = (load_study(name, tiny=False).paper for name in ("landmarks", "lab"))
    assert landmarks == {f"{method}_{kind}": one[0] for (kind, method), one in paper.PAPERS_LANDMARKS.items()}
    assert lab == {
        f"{method}_label_{name}": figures[place][0]
        for method, figures in paper.PAPERS_LAB.items()
        for place, name in enumerate(paper.PAPERS_ERRORS)
    }
    lidar = load_study("lidar", tiny=False).paper
    ours, baseline = (np.array(paper.PAPERS_LIDAR[name]) for name in ("deepgps", "pca_knn"))
    worst = (ours / baseline).max(axis=0)
    assert (lidar["rms_ratio"], lidar["median_ratio"]) == pytest.approx(tuple(worst[:2]), abs=0.005)
    assert (lidar["rms_m"], lidar["median_m"]) == pytest.approx(tuple(ours.mean(axis=0)[:2]), abs=0.0005)


def test_the_studies_are_the_papers_experiments():
    landmarks, lidar, lab = (
        [plan.scenario for plan in plan_runs(load_study(name, tiny=False))] for name in ("landmarks", "lidar", "lab")
    )
    assert {one.landmarks.reach_m for one in landmarks} == {None, 0.6}
    for one in landmarks:
        assert (one.world, one.landmarks.count, one.landmarks.segments) == ("landmarks", 128, 128)
        assert (one.drive.spacing_m, one.encoder.step_noise) == (0.02, 0.0)
    assert [one.obstacles.seed for one in lidar] == [0, 1, 2, 3]
    for one in lidar:
        assert (one.lidar.rays, one.drive.samples) == (256, 10_000)
        assert one.learn.pca.headings == 100
        # A heading that all four scans of a place share would make it easier than it is.
        assert (one.lidar.rays * np.arange(1, 5) / one.grid.headings % 1 > 0).all()
    assert [one.seed for one in lab] == [0, 1, 2, 3, 4, 5]
    for one in lab:
        assert (one.room.kind, one.room.seed, one.tag_camera.mounted) == ("lab", 0, True)
        assert (one.drive.strategy, one.drive.samples, one.grid.held_out) == ("endpoint", 1570, 314)


def test_the_training_time_is_that_of_deepgps_alone():
    rows = [
        {"method": method, "rms_m": 0.01, "train_s": seconds, paper.REACH: None}
        for method, seconds in (("deepgps", 10.0), ("deepgps", 11.0), ("posenet", 900.0))
    ]
    assert paper.measure_landmarks(rows)["train_s"].value == 10.5


def test_the_target_of_lidar_is_that_of_the_worst_map():
    def make_row(number: int, method: str, rms: float) -> Row:
        stored = 130_000_000 if method == "pca_knn" else 400_000
        errors = {"rms_m": rms, "median_m": rms / 4, "max_m": 20 * rms, "train_s": 10.0, "stored": stored}
        return {"recording": f"map{number}", "method": method, **errors}

    rows = [make_row(*one) for one in ((0, "deepgps", 0.04), (0, "pca_knn", 0.08), (1, "deepgps", 0.06))]
    figures = paper.measure_lidar([*rows, make_row(1, "pca_knn", 0.05)])
    assert figures["rms_ratio"].value == pytest.approx(1.2)
    assert figures["stored_ratio"].value == 325.0


def test_what_is_accepted_is_beside_the_errors_of_all_in_the_lab():
    errors = {name: 0.03 for name in ("rms_m", "median_m", "max_m", "label_rms_m", "label_median_m", "label_max_m")}
    more = {"labels_rms_m": 0.005, "unlabelled": 200, "test_unlabelled": 30, "train_s": 40.0}
    accepted = {"accepted": 0.9, "rms_accepted_m": 0.05, "max_accepted_m": 0.08}
    table = paper.report_lab([{"seed": 1, "method": "deepgps", **errors, **more, **accepted}], ["seed"])[0]
    assert cells(table, "1", "DeepGPS")[8:] == ["5.0", "8.0", "90.0 %", "200 + 30", "0.5", "40"]
    assert cells(table, "mean ± std", "DeepGPS")[7:12] == ["3.0 ± 0.0", "5.0", "8.0", "90.0 %", "-"]
    assert len({line.count("|") for line in table.splitlines()}) == 1


def test_methods_and_settings_are_refused_in_worlds_without_what_they_need():
    for world, settings, field in (
        ("landmarks", {"tag_camera.mounted": "true"}, "tag_camera.mounted"),
        ("landmarks", {"grid.held_out": "5"}, "grid.held_out"),
        ("living_room", {"methods": ["pca_knn"]}, "pca_knn"),
        ("tiny", {"sensor": "lidar", "learn.network.architecture": "resnet"}, "'resnet' needs images"),
        ("lidar", {"methods": ["explicit"]}, "explicit needs distances to landmarks"),
    ):
        with pytest.raises(InputError, match=field):
            load_scenario(world, settings)
    assert load_scenario("living_room", {"methods": ["pca_knn"], "sensor": "lidar"}).sensor == "lidar"


@pytest.mark.slow
def test_every_method_of_landmarks_runs_to_the_viewer(tmp_path: Path):
    methods = ["deepgps", "posenet", "dead_reckoned_labels", "knn", "explicit", "explicit_mds"]
    folder = make_small("landmarks", methods, tmp_path / "run", *LANDMARKS, *EXPLICIT)
    with np.load(folder / "error_field.npz") as field:
        for method in methods:
            shown = read_error_field(folder / RECORDING, method)
            assert np.allclose(shown.predicted, field[method][:, 0], atol=1e-5)
        assert np.abs(field["explicit_mds"][:, 0] - field["truth"]).max() < 1e-3
    assert (folder / "figures" / "error_fields.png").is_file()


@pytest.mark.slow
def test_every_method_of_lidar_runs_to_the_viewer_and_its_columns_add_up(tmp_path: Path):
    methods = ["deepgps", "posenet", "knn", "pca_knn"]
    folder = make_small("lidar", methods, tmp_path / "run", *LIDAR, *FEATURES, *PCA)
    with np.load(folder / "error_field.npz") as field:
        for method in methods:
            error = np.linalg.norm(field[method] - field["truth"][:, None], axis=-1)
            shown = read_error_field(folder / RECORDING, method)
            assert np.allclose(shown.error, error.max(axis=1), atol=1e-5)
            own = paper.add_scans(folder, {"method": method})
            assert own["each_rms_m"] == pytest.approx(np.sqrt((error**2).mean()))
            stored = [tensor.size for tensor in load_file(folder / method / "weights.safetensors").values()]
            assert own["stored"] == sum(stored)
            assert own["each_max_m"] == read_json(folder / "metrics.json")["methods"][method]["max_m"]
    assert any(chunk.entity_path.endswith("/scan") for chunk in open_rrd(folder / RECORDING).stream())


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
    row = {"method": "deepgps", "run": "one", "seed": plan.scenario.seed, "rms_m": 1.0}
    columns = paper.add_labels(folder, row)
    assert columns["labels_rms_m"] == labels["rms_m"] and columns["unlabelled"] == labels["unlabelled"]
    assert len(paper.draw_lab_places([row], ["seed"], tmp_path).axes) == len(plan.scenario.methods)
    paths = {str(chunk.entity_path) for chunk in open_rrd(folder / RECORDING).stream()}
    assert {"/world/error_field/deepgps", "/drive/fisheye", "/drive/tag_camera"} <= paths
