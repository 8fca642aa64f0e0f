"""A run opened from Python: positions in the world's frame, errors as a table, and what is missing in one line."""

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

import deepgps
from deepgps.evaluation.error_field import read_all_headings
from sim.files.checksums import read_arrays, read_json, write_json
from sim.recording.format import open_truth
from tests.helpers.synthetic_run import write_synthetic_run

METHODS = ("deepgps", "knn")


@pytest.fixture(scope="module")
def run(finished_run: Path) -> deepgps.Run:
    return deepgps.load(finished_run)


@pytest.fixture
def copied(run: deepgps.Run, tmp_path: Path) -> deepgps.Run:
    """The same in a folder that a test may change."""
    return deepgps.load(copytree(run.folder, tmp_path / "run"))


@pytest.mark.parametrize("method", METHODS)
def test_poses_of_the_test_images_are_those_of_the_error_field(run: deepgps.Run, method: str):
    images, field = run.recording.test_observation, read_arrays(run.folder / "error_field.npz")
    flat, predicted = images.reshape(-1, *images.shape[2:]), field[method].reshape(-1, 2)
    np.testing.assert_allclose(run.position(flat, method), predicted, rtol=0, atol=1e-6)
    np.testing.assert_allclose(run.position(flat[3], method), predicted[3], rtol=0, atol=1e-6)
    assert run.position(flat[3], method).shape == (2,)
    assert run.position(flat[:0], method).shape == (0, 2)
    found = run.pose(flat, method)
    np.testing.assert_allclose(found.position, predicted, rtol=0, atol=1e-6)
    for part in ("yaw", "yaw_std"):
        np.testing.assert_allclose(vars(found)[part], field[f"{part}/{method}"].ravel(), rtol=0, atol=1e-5)
    assert found.radius_68 is not None and (found.radius_68 > 0).all()
    one, own = run.pose(images[0, 0], method), run.pose(images[0, 0], method, frame="map")
    assert one.yaw is not None and own.yaw is not None
    assert one.position.shape == (2,) and np.shape(one.yaw) == ()
    assert one.yaw_std == own.yaw_std and one.yaw != own.yaw


def test_the_map_s_own_frame_differs_by_the_alignment_alone(run: deepgps.Run):
    images = run.recording.test_observation[:, 0]
    world, own = run.position(images), run.position(images, frame="map")
    assert not np.allclose(world, own)
    between = [np.linalg.norm(places[:, None] - places, axis=-1) for places in (world, own)]
    np.testing.assert_allclose(*between, atol=1e-9)


def test_errors_hold_one_row_for_each_place_and_heading(run: deepgps.Run):
    truth = open_truth(run.folder / "recording").test_pose.reshape(-1, 3)
    table = run.errors()
    assert table.column_names == [
        *("method", "x_m", "y_m", "heading_rad", "predicted_x_m", "predicted_y_m", "error_m"),
        *("predicted_yaw_rad", "yaw_error_rad", "novelty", "radius_68_m", "radius_95_m", "accepted"),
    ]
    assert table.num_rows == len(run.methods) * len(truth)
    for method in METHODS:
        rows = run.errors(method).to_pandas()
        assert set(rows.method) == {method}
        np.testing.assert_allclose(rows[["x_m", "y_m", "heading_rad"]], truth)
        away = np.hypot(rows.predicted_x_m - rows.x_m, rows.predicted_y_m - rows.y_m)
        np.testing.assert_allclose(rows.error_m, away)
        turns = (rows.predicted_yaw_rad - rows.heading_rad - rows.yaw_error_rad) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)
        yaw_rms_deg = run.metrics["methods"][method]["yaw_rms_deg"]
        assert np.degrees(np.sqrt((rows.yaw_error_rad**2).mean())) == pytest.approx(yaw_rms_deg)
        worst = rows.groupby(["x_m", "y_m"]).error_m.max()
        assert worst.max() == pytest.approx(run.metrics["methods"][method]["max_m"])


def test_errors_hold_what_a_method_accepts_and_nothing_where_it_does_not_say(tmp_path: Path):
    folder = write_synthetic_run(tmp_path / "run", samples=60, spacing_m=0.4)
    run, field = deepgps.load(folder), read_all_headings(folder)["deepgps"]
    rows = run.errors("deepgps").to_pandas()
    for column, part in (("novelty", field.novelty), ("radius_68_m", field.radius), ("accepted", field.accepted)):
        assert part is not None
        np.testing.assert_array_equal(rows[column], part.ravel())
    assert rows.accepted.mean() == run.metrics["methods"]["deepgps"]["accepted"]
    silent = run.errors("knn")
    for column in ("novelty", "radius_68_m", "radius_95_m", "accepted"):
        assert silent.column(column).null_count == silent.num_rows


def test_a_run_says_what_it_holds(run: deepgps.Run):
    assert run.methods == run.scenario.methods == ("deepgps_compass", "deepgps", "posenet", "knn")
    assert run.scenario.drive.samples == len(run.recording.observation)
    assert deepgps.load(str(run.folder)) == run
    said = run.report()
    assert "DeepGPS" in said and "reachable test positions" in said
    for method in METHODS:
        stored, metrics = read_json(run.folder / method / "alignment.json"), run.metrics["methods"][method]
        assert stored["fitted_on"] == "truth"
        assert (stored["kind"], stored["scale"]) == (metrics["alignment"], metrics["scale"])


@pytest.mark.slow
def test_a_lost_alignment_is_made_again_by_evaluating(copied: deepgps.Run):
    images = copied.recording.test_observation[:, 0]
    before = copied.position(images, "deepgps")
    (copied.folder / "deepgps" / "alignment.json").unlink()
    with pytest.raises(deepgps.InputError, match=r"has no alignment.json.*; deepgps evaluate .* writes it"):
        copied.position(images, "deepgps")
    again = deepgps.simulate(copied.scenario, copied.folder, progress=False)
    assert np.array_equal(again.position(images, "deepgps"), before)


@pytest.mark.slow
def test_a_method_is_added_to_a_finished_run(tmp_path: Path):
    settings = {"landmarks.segments": 40, "learn.train.steps": 20, "grid.spacing_m": 0.2}
    one = deepgps.simulate("landmarks", tmp_path / "run", ["explicit"], settings, progress=False)
    weights = (one.folder / "explicit" / "positioner.json").read_bytes()
    both = deepgps.simulate("landmarks", tmp_path / "run", ["posenet"], settings, progress=False)
    assert list(both.methods) == ["explicit", "posenet"]
    assert (one.folder / "explicit" / "positioner.json").read_bytes() == weights


def test_an_alignment_of_another_training_is_refused(copied: deepgps.Run):
    path = copied.folder / "deepgps" / "alignment.json"
    write_json(path, {**read_json(path), "positioner": "0" * 64})
    with pytest.raises(deepgps.InputError, match="belongs to an earlier training"):
        copied.position(copied.recording.test_observation[:, 0], "deepgps")


def test_what_does_not_exist_is_named_in_one_line(run: deepgps.Run, tmp_path: Path):
    image = run.recording.test_observation[0, 0]
    for message, call in {
        "method 'pca_knn': .* has trained deepgps_compass, deepgps": lambda: run.position(image, "pca_knn"),
        "method 'pca_knn': .* has measured deepgps_compass, deepgps": lambda: run.errors("pca_knn"),
        "frame 'room': must be 'world' or 'map'": lambda: run.position(image, frame="room"),  # pyright: ignore[reportArgumentType]
        r"observations of shape \(4, 32, 3\), but trained on": lambda: run.position(image[:4]),
        "is no run folder": lambda: deepgps.load(tmp_path),
        "holds a run of another scenario": lambda: deepgps.simulate("tiny", run.folder, progress=False),
    }.items():
        with pytest.raises(deepgps.InputError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_smallest_scenario_shows_registration_ahead_of_the_nearest_image_and_of_the_wheels(tmp_path: Path):
    run = deepgps.simulate("tiny", tmp_path / "run", methods=["registration", "knn"], progress=False)
    found = {**run.metrics["methods"], "wheels": run.metrics["trajectory"]}
    for figure in ("rms_m", "median_m", "max_m"):
        registered, nearest, wheels = (found[name][figure] for name in ("registration", "knn", "wheels"))
        assert registered < 0.7 * nearest and nearest < 0.2 * wheels, figure
    assert found["registration"]["rms_m"] < 0.03
