"""A recording of one's own data: checked, trained, positioned and viewed, with and without the truth."""

from pathlib import Path

import numpy as np
import pytest

import deepgps
from deepgps.runs.source import choose_folder
from deepgps.viewer.run import find_recording
from sim.recording.format import check_recording, has_truth, open_recording, open_truth
from sim.recording.manifest import ObservationKind
from tests.helpers.command import deepgps_here
from tests.helpers.toy import make_toy

QUICK = {"learn.train.steps": 20, "learn.network.width": 16, "learn.fold.restarts": 0, "learn.train.segments": 4}
ODOMETRY = {"wheel_radius_m": 0.033, "track_m": 0.16, "ticks_per_rev": 4096}


@pytest.fixture(scope="module")
def drive(small_recording: Path) -> dict:
    """What a robot of one's own would have recorded, with its true poses apart."""
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    return {
        "arrays": {
            "observations": np.array(recording.observation),
            "readings": recording.reading,
            "time": recording.time,
            "odometry": recording.manifest.odometry,
            "test_observations": np.array(recording.test_observation),
        },
        "truth": {"pose": truth.pose, "test_pose": truth.test_pose},
    }


@pytest.mark.slow
def test_one_s_own_recording_is_trained_positioned_and_viewed_without_truth(drive: dict, tmp_path: Path):
    folder = deepgps.write_recording(tmp_path / "mine", **drive["arrays"])
    check_recording(folder)
    assert not has_truth(folder)
    run = deepgps.train(folder, out=tmp_path / "run", settings=QUICK, progress=False)
    images = drive["arrays"]["test_observations"][:, 0]
    assert run.position(images, frame="map").shape == (len(images), 2)
    with pytest.raises(deepgps.InputError, match=r"has no truth, .*frame='map' gives"):
        run.position(images)
    with pytest.raises(deepgps.InputError, match="has not been evaluated"):
        run.errors()
    assert find_recording(run.folder).stat().st_size > 10_000


def test_turns_of_one_s_own_are_kept_and_checked(drive: dict, small_recording: Path, tmp_path: Path):
    given = open_recording(small_recording)
    assert given.turns is not None
    images: dict = {"turn_observations": given.turn_observation}
    folder = deepgps.write_recording(tmp_path / "mine", **drive["arrays"], turns=given.turns.array, **images)
    copy = open_recording(folder)
    assert copy.turns is not None and copy.turn_observation is not None
    np.testing.assert_array_equal(copy.turns.array, given.turns.array)
    np.testing.assert_array_equal(copy.turn_observation, given.turn_observation)
    for column, value, message in (
        (0, 300, "turns: observation 300 must be from 0 to 299"),
        (1, 9999, "turns: turn observation 9999 must be from -1 to"),
        (3, 3, "turns: kind 3 must be from 0 to 2"),
        (2, 1, "turns: no segment begins at row 1 of readings"),
    ):
        wrong = given.turns.array
        wrong[0, column] = value
        with pytest.raises(deepgps.InputError, match=message):
            deepgps.write_recording(tmp_path / "wrong", **drive["arrays"], turns=wrong, **images)
    seen = np.asarray(given.turn_observation) / 255.0
    with pytest.raises(deepgps.InputError, match="turn_observations float64: must be uint8, as observations are"):
        deepgps.write_recording(tmp_path / "wrong", **drive["arrays"], turns=given.turns.array, turn_observations=seen)
    with pytest.raises(deepgps.InputError, match="turn_observations need turns"):
        deepgps.write_recording(tmp_path / "wrong", **drive["arrays"], **images)


@pytest.mark.parametrize("name", ["encoder.step_noise", "seed"])
def test_a_recording_that_is_made_takes_no_settings_of_its_drive(name: str, drive: dict, tmp_path: Path):
    folder = deepgps.write_recording(tmp_path / "mine", **drive["arrays"])
    with pytest.raises(deepgps.InputError, match=f"{name}: the recording .* is made already; with it, only methods"):
        deepgps.train(folder, out=tmp_path / "run", settings={**QUICK, name: 1}, progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_with_the_truth_it_is_also_evaluated(drive: dict, tmp_path: Path):
    folder = deepgps.write_recording(tmp_path / "mine", **drive["arrays"], **drive["truth"])
    run = deepgps.train(folder, ["deepgps", "knn"], tmp_path / "run", QUICK, progress=False)
    assert run.methods == ("deepgps", "knn")
    errors = run.errors("knn").to_pandas()
    np.testing.assert_allclose(errors[["x_m", "y_m"]], drive["truth"]["test_pose"][..., :2].reshape(-1, 2))
    assert run.metrics["methods"]["knn"]["median_m"] < 1.0
    assert "flipped" not in run.metrics["methods"]["knn"], "test positions of one's own need not form a grid"
    assert find_recording(run.folder).stat().st_size > 10_000
    assert (run.folder / "recording").resolve() == folder.resolve()


def test_with_the_truth_but_no_test_images_it_is_trained_and_nothing_is_measured(drive: dict, tmp_path: Path):
    arrays = {**drive["arrays"], "test_observations": None}
    folder = deepgps.write_recording(tmp_path / "mine", **arrays, pose=drive["truth"]["pose"])
    done = deepgps_here("run", "mine", "--methods", "knn", "--out", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (line,) = done.stdout.splitlines()
    assert line.startswith("run: all methods are trained; errors cannot be measured, since the recording")
    assert not (tmp_path / "run" / "metrics.json").exists()
    assert deepgps.train(folder, ["knn"], tmp_path / "again", progress=False).methods == ("knn",)


@pytest.mark.slow
def test_it_is_learned_like_the_recording_that_it_was_made_from(drive: dict, small_recording: Path, tmp_path: Path):
    copy = deepgps.write_recording(tmp_path / "mine", **drive["arrays"])
    runs = [
        deepgps.train(folder, ["deepgps"], tmp_path / folder.name / "run", QUICK, progress=False)
        for folder in (copy, small_recording)
    ]
    weights = [(run.folder / "deepgps" / "weights.safetensors").read_bytes() for run in runs]
    assert weights[0] == weights[1]


@pytest.mark.parametrize(("kind", "shape"), [("vector", (12,)), ("scan", (1, 40))])
def test_other_kinds_of_observations_are_written_and_described(kind: ObservationKind, shape: tuple, tmp_path: Path):
    toy = make_toy(tmp_path / "toy", samples=60)
    observations = np.random.default_rng(0).uniform(0.1, 3.0, (60, *shape))
    folder = deepgps.write_recording(
        tmp_path / "mine",
        observations,
        toy.reading[toy.reading[:, 1] < 60],
        toy.time[toy.reading[:, 1] < 60],
        ODOMETRY,
        kind=kind,
    )
    assert open_recording(folder).kind == kind
    run = deepgps.train(folder, ["deepgps"], tmp_path / "run", QUICK, progress=False)
    assert run.scenario.observation == kind
    assert run.position(observations[0], frame="map").shape == (2,)


def test_wrong_data_are_refused_in_one_line_and_leave_nothing(drive: dict, tmp_path: Path):
    arrays, truth = drive["arrays"], drive["truth"]
    count = len(arrays["observations"])
    for message, changed in {
        "readings float64: must be integers": {"readings": arrays["readings"] * 1.0},
        "odometry.track_m must be a number": {"odometry": {"wheel_radius_m": 0.03, "ticks_per_rev": 4096}},
        "kind 'image': must be polar_image": {"kind": "image"},
        "observations .* float64: must be .* uint8 RGB": {"observations": arrays["observations"] / 255},
        "observations .* have 4 axes": {"observations": arrays["observations"][0]},
        r"test_observations .*: must be \(C, H": {"test_observations": arrays["test_observations"][..., :-1, :]},
        r"pose \(2, 3\): must have the shape": {"pose": np.zeros((2, 3))},
        "test_pose: .* test positions need their poses": {"pose": truth["pose"]},
        "pose: test_pose and free_space need": {"test_pose": truth["test_pose"]},
        "pose and test_pose: must be finite": {**truth, "pose": np.full((count, 3), np.nan)},
        "pose: covers .* x .* m, more than the 10000 m2 .*; give free_space": {**truth, "pose": truth["pose"] * 1000.0},
        r"observations \(\d+, 2, .*\), test_.*: camera.rings 2: must be": {
            "observations": arrays["observations"][:, :2],
            "test_observations": arrays["test_observations"][:, :, :2],
        },
    }.items():
        with pytest.raises(deepgps.InputError, match=message) as caught:
            deepgps.write_recording(tmp_path / "mine", **{**arrays, **changed})
        assert "\n" not in str(caught.value)
        assert not (tmp_path / "mine").exists()


def test_a_folder_that_holds_something_is_left_alone(drive: dict, tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(deepgps.InputError, match="is not empty; a recording is written to a folder of its own"):
        deepgps.write_recording(tmp_path, **drive["arrays"])
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_recording_that_was_interrupted_is_written_by_the_same_call(
    drive: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with monkeypatch.context() as broken:
        broken.setattr("deepgps.api.record.check_recording", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            deepgps.write_recording(tmp_path / "mine", **drive["arrays"], **drive["truth"])
    assert list(tmp_path.iterdir()) == []
    check_recording(deepgps.write_recording(tmp_path / "mine", **drive["arrays"], **drive["truth"]))


def test_a_drive_whose_length_is_not_recorded_is_measured_by_the_wheels(tmp_path: Path):
    toy = make_toy(tmp_path / "toy", samples=300)
    assert toy.manifest.distance_driven_m is None and toy.manifest.segments is None
    run = deepgps.train(toy.folder, ["knn"], tmp_path / "run", progress=False)
    pose, (segment, image) = open_truth(toy.folder).pose, toy.reading[:, :2].T
    distance = np.linalg.norm(np.diff(pose[image, :2], axis=0), axis=1)[np.diff(segment) == 0].sum()
    said = run.report().replace("\n", " ")
    assert f"{len(pose)} observations on {len(np.unique(segment))} straight segments, {distance:.0f} m driven" in said


def test_another_recording_in_the_same_run_folder_is_refused(tmp_path: Path):
    toys = [make_toy(tmp_path / f"toy{seed}", samples=60, seed=seed).folder for seed in (0, 1)]
    deepgps.train(toys[0], out=tmp_path / "run", settings={**QUICK, "name": "toy"}, progress=False)
    with pytest.raises(deepgps.InputError, match="holds a run on another recording"):
        deepgps.train(toys[1], out=tmp_path / "run", settings={**QUICK, "name": "toy"}, progress=False)
    homes = {choose_folder(toy, deepgps.load(tmp_path / "run").scenario) for toy in toys}
    assert len(homes) == 2
