"""The study of lidar maps: its report from made-up rows, and one of its runs for real, small, to its last file."""

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from deepgps.config.scenario import load_scenario
from deepgps.run import run
from deepgps.studies.catalog import REPORTS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.lidar import PAPER, add, draw, measure, report
from deepgps.studies.reports.report import write_report
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from deepgps.viewer.read import open_rrd, read_error_field
from deepgps.viewer.run.drive import ROBOT
from deepgps.viewer.run.recording import RECORDING
from sim.errors import InputError
from sim.files.json_files import read_json

SMALL = {
    "lidar.rays": 32,
    "lidar.headings": 2,
    "drive.samples": 400,
    "grid.spacing_m": 0.25,
    "grid.headings": 2,
    "learn.train.steps": 20,
    "learn.train.segments": 4,
    "learn.network.width": 16,
    "learn.features.rings": 4,
    "learn.features.principal": 32,
    "learn.features.components": 16,
    "learn.pca.headings": 5,
    "learn.fold.restarts": 0,
}


def make_rows(rms: dict[tuple[int, str], float]) -> list[Row]:
    """A row for each map and method."""
    return [
        {"obstacles.seed": number, "recording": f"map{number}", "run": f"map{number}", "method": method, "rms_m": value}
        | {"median_m": value / 4, "max_m": 20 * value, "train_s": 10.0 + number}
        | {"each_rms_m": value / 2, "each_median_m": value / 8, "each_max_m": 20 * value}
        | {"stored": 130_000_000 if method == "pca_knn" else 400_000}
        for (number, method), value in rms.items()
    ]


ROWS = make_rows({(0, "deepgps"): 0.04, (0, "pca_knn"): 0.08, (1, "deepgps"): 0.06, (1, "pca_knn"): 0.05})


def cells(lines: list[str], *first: str) -> list[str]:
    """The cells of the one line that begins with these."""
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    (line,) = [line for line in found if tuple(line[: len(first)]) == first]
    return line


def test_every_map_stands_beside_the_papers_figures():
    lines = report(ROWS, ["obstacles.seed"])[0].splitlines()
    ours = ["0.0600", "0.0150", "1.200", "0.0300", "0.0075", "1.200", "0.40", "11"]
    assert cells(lines, "2", "DeepGPS")[2:] == [*ours, "0.177", "0.0060", "2.146"]
    assert cells(lines, "1", "PCA + nearest neighbour")[-5:] == ["130.00", "10", "0.142", "0.0130", "1.980"]


def test_the_target_is_that_of_the_worst_map():
    study = load_study("lidar", tiny=False)
    plan, *_ = plan_runs(study)
    rows = [{**row, "failure": None} for row in ROWS]
    lines = write_report(study, [plan], {}, rows).splitlines()
    named = "RMS / PCA + nearest neighbour's, worst map"
    assert cells(lines, named)[1:] == ["1.20", "-", "1.20", "<= 1.00", "missed", "1.17"]
    assert measure(ROWS)["stored_ratio"].value == 325.0
    assert set(measure(ROWS)) <= set(REPORTS["lidar"].targets)


def test_the_papers_ratios_are_those_of_its_table():
    paper = load_study("lidar", tiny=False).paper
    ours, baseline = (np.array(PAPER[name]) for name in ("deepgps", "pca_knn"))
    worst = (ours / baseline).max(axis=0)
    assert (paper["rms_ratio"], paper["median_ratio"]) == pytest.approx(tuple(worst[:2]), abs=0.005)
    assert (paper["rms_m"], paper["median_m"]) == pytest.approx(tuple(ours.mean(axis=0)[:2]), abs=0.0005)


def test_the_study_is_the_papers_experiment():
    plans = plan_runs(load_study("lidar", tiny=False))
    assert [plan.scenario.obstacles.seed for plan in plans] == [0, 1, 2, 3]
    for plan in plans:
        scenario = plan.scenario
        assert (scenario.world, scenario.lidar.rays, scenario.drive.samples) == ("obstacles", 256, 10_000)
        assert scenario.learn.pca.headings == 100
        # A heading that all four scans of a place share would make it easier than it is.
        assert (scenario.lidar.rays * np.arange(1, 5) / scenario.grid.headings % 1 > 0).all()


def test_methods_are_refused_where_there_are_no_scans():
    with pytest.raises(
        InputError, match="methods: pca_knn needs scans, which world obstacles or, in a room, sensor lidar"
    ):
        load_scenario("living_room", {"methods": ["pca_knn"]})
    assert load_scenario("living_room", {"methods": ["pca_knn"], "sensor": "lidar"}).sensor == "lidar"
    with pytest.raises(InputError, match="'resnet' needs images, which sensor lidar does not give"):
        load_scenario("tiny", {"sensor": "lidar", "learn.network.architecture": "resnet"})
    with pytest.raises(InputError, match="methods: explicit needs distances to landmarks"):
        load_scenario("lidar", {"methods": ["explicit"]})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lidar") / "runs" / "map0"
    methods = ["deepgps", "posenet", "knn", "pca_knn"]
    run(load_scenario("lidar", {**SMALL, "methods": methods}), folder, fresh=False, progress=ignore)
    return folder


def test_every_method_runs_to_the_viewer(folder: Path):
    with np.load(folder / "error_field.npz") as field:
        for method in ("deepgps", "posenet", "knn", "pca_knn"):
            error = np.linalg.norm(field[method] - field["truth"][:, None], axis=-1)
            shown = read_error_field(folder / RECORDING, method)
            assert np.allclose(shown.error, error.max(axis=1), atol=1e-5)
            own = add(folder, {"method": method})
            assert own["each_rms_m"] == pytest.approx(np.sqrt((error**2).mean()))
            stored = [tensor.size for tensor in load_file(folder / method / "weights.safetensors").values()]
            assert own["stored"] == sum(stored)
            assert own["each_max_m"] == read_json(folder / "metrics.json")["methods"][method]["max_m"]
    assert f"/{ROBOT}/scan" in {chunk.entity_path for chunk in open_rrd(folder / RECORDING).stream()}


def test_the_picture_shows_each_map_and_method(folder: Path):
    rows = [row for row in ROWS if row["recording"] == "map0"]
    picture = draw(rows, ["obstacles.seed"], folder.parents[1])
    titles = [axes.get_title(loc="left") for axes in picture.axes if axes.get_title(loc="left")]
    assert titles == [
        "map 1, DeepGPS\nRMS 0.0400 m, median 0.0100 m",
        "map 1, PCA + nearest neighbour\nRMS 0.0800 m, median 0.0200 m",
    ]
