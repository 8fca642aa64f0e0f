"""What a log holds is printed as a robot.yaml that imports it; the command and the file's errors."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from deepgps.commands.main import main
from deepgps.robot_io.logs import containers
from deepgps.robot_io.logs.camera import read_calibration
from deepgps.robot_io.logs.look import look
from deepgps.robot_io.logs.robot_config import RobotConfig, load_config
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.files.checksums import read_json, sha256
from sim.recording.format import check_recording
from tests.helpers.robot_log import (
    CAMERA,
    CAMERA_INFO,
    JOINTS,
    TRUTH,
    change,
    make_notes,
    set_fields,
    sort,
    write_log,
    write_plain,
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("look") / "log", make_notes("image/jpeg"), "mcap_lz4")


def test_the_proposed_file_imports_the_log(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["import", str(log), "--look"])
    said = capsys.readouterr().out
    config = tmp_path / "robot.yaml"
    config.write_text(said)
    main(["import", str(log), "--config", str(config), "--out", str(tmp_path / "mine")])
    said = capsys.readouterr().out
    assert "5 segments" in said and "4 turns in place, 4 of them seen before and after" in said
    check_recording(tmp_path / "mine")
    manifest = read_json(tmp_path / "mine" / "manifest.json")
    assert manifest["source"] == "log" and manifest["log"]["config_sha256"] == sha256(config)
    assert manifest["settings"]["camera"]["field_of_view_deg"] == pytest.approx(143.24, abs=0.3)
    with pytest.raises(SystemExit) as ended:
        main(["import", str(log), "--config", str(config), "--out", str(tmp_path / "mine")])
    assert ended.value.code == 2 and "is not empty" in capsys.readouterr().err
    for words in (["--look", "--out", "x"], [], ["--out", "x"]):
        with pytest.raises(SystemExit) as ended:
            main(["import", "log.mcap", *words])
        said = capsys.readouterr().err
        assert ended.value.code == 2 and "--config FILE" in said and "--out FOLDER" in said


@pytest.mark.parametrize("kind", ["mcap_lz4", "db3"])
def test_messages_are_counted_while_a_log_is_read(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(containers, "STRIDE", 50)
    told: list[tuple[int, int]] = []
    look(write_log(tmp_path / "log", make_notes("image/jpeg"), kind), lambda label, *done: told.append(done[:2]))
    total = told[0][1]
    assert total > 100
    assert told == [*((done, total) for done in range(0, total, 50)), (total, total)]


def test_a_goal_is_not_proposed_as_the_pose(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    notes = make_notes("image/jpeg")
    pose = next(note for note in notes if note.topic == TRUTH)
    goals = [replace(pose, topic="/goal_pose", log_ns=pose.log_ns + s * 10**9) for s in (5, 12)]
    main(["import", str(write_log(tmp_path / "log", sort([*notes, *goals]), "mcap_lz4")), "--look"])
    said = capsys.readouterr().out
    assert yaml.safe_load(said)["pose"]["topic"] == TRUTH


def test_topics_types_rates_clocks_joints_and_calibration_are_told(log: Path) -> None:
    said = look(log, ignore)
    for part in (
        "# /joint_states  sensor_msgs/msg/JointState  66",
        "#     20.0 Hz, 33.",
        "logged +0.0030 s after its stamp, in the median; 0 without stamp, 0 out of order",
        "#     joints: wheel_left_joint, wheel_right_joint",
        "format 'rgb8; jpeg compressed bgr8', 96 x 80 px",
        "equidistant, 96 x 80 px, fx fy cx cy 32, 32, 47.5, 39.5",
        "# /range/front  sensor_msgs/msg/Range  66",
    ):
        assert part in said
    config = RobotConfig.model_validate(yaml.safe_load(said))
    assert (config.wheels.topic, config.camera.topic, config.camera.info) == (JOINTS, CAMERA, CAMERA_INFO)
    assert config.pose is not None and config.pose.topic == TRUTH and config.wheels.lag_s == "estimate"


def test_without_a_calibration_a_circle_is_proposed(tmp_path: Path) -> None:
    notes = change(make_notes("image/jpeg"), CAMERA_INFO, lambda _, note: set_fields(note, focal=0.0))
    said = look(write_log(tmp_path / "log", notes, "mcap_lz4"), ignore)
    assert "not calibrated: K is 0" in said
    assert RobotConfig.model_validate(yaml.safe_load(said)).camera.circle_px == 40  # half of 80 px


def test_a_plain_folder_is_looked_at(tmp_path: Path) -> None:
    config = RobotConfig.model_validate(yaml.safe_load(look(write_plain(tmp_path / "plain"), ignore)))
    assert (config.wheels.topic, config.wheels.left, config.camera.topic) == ("wheels.csv", "left", "images")


def test_a_wrong_robot_is_refused_in_one_line(tmp_path: Path) -> None:
    base: dict = {"wheels": {"radius_m": 0.033, "track_m": 0.16}, "camera": {"topic": "/c", "info": "/i"}}
    path = tmp_path / "robot.yaml"
    for values, message in (
        ({"wheels": {**base["wheels"], "radius_m": 0.0}}, r"wheels\.radius_m 0\.0: must be greater than 0\.001"),
        ({"wheels": {**base["wheels"], "lag_s": 7.0}}, r"wheels.lag_s: 7.0 must be from -1 to 1 s"),
        ({"wheels": {**base["wheels"], "lag_s": "estimated"}}, r"wheels.lag_s: 'estimated' must be .*estimate"),
        ({"camera": {"topic": "/c"}}, "without info, file or intrinsics, field_of_view_deg and circle_px are needed"),
        ({"camera": {"topic": "/c", "info": "/i", "file": "x.yaml"}}, "info and file: give one of them"),
        ({"pose": {"topic": "/p", "use": "both"}}, r"pose\.use 'both': must be 'truth' or 'labels'"),
        ({"speed": 1}, "speed: there is no such setting"),
        ({"clocks": "guess"}, "clocks 'guess': must be 'checked' or 'logged'"),
        ({"clocks": "align"}, "clocks: 'align': clocks are not aligned; logged takes the times of logging"),
    ):
        path.write_text(yaml.safe_dump({**base, **values}))
        with pytest.raises(InputError, match=message) as caught:
            load_config(path)
        assert "\n" not in str(caught.value)


CALIBRATION = {
    "image_width": 96,
    "image_height": 80,
    "distortion_model": "fisheye",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [32.0, 0, 47.5, 0, 32.0, 39.5, 0, 0, 1]},
    "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.0, 0.0, 0.0, 0.0]},
}


def test_a_wrong_calibration_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "ost.yaml"
    for name, value, message in (
        ("image_width", float("inf"), "image_width inf: must be a whole number"),
        ("image_width", float("nan"), "image_width nan: must be a whole number"),
        ("image_height", 80.5, r"image_height 80\.5: must be a whole number"),
        ("image_height", [80], r"image_height \[80\]: must be a whole number"),
        ("camera_matrix", {"data": "123456789"}, r"camera_matrix\.data '123456789': must be a list"),
        ("camera_matrix", {"data": [1.0] * 8}, r"camera_matrix\.data has 8 numbers, and must have 9"),
        ("camera_matrix", {"data": [True] * 9}, r"camera_matrix\.data .*: must be a list of finite numbers"),
        ("distortion_coefficients", {"data": {"a": 1}}, r"distortion_coefficients\.data .* must be a list"),
        ("distortion_coefficients", None, r"distortion_coefficients\.data None: must be a list"),
    ):
        path.write_text(yaml.safe_dump({**CALIBRATION, name: value}))
        with pytest.raises(InputError, match=message) as caught:
            read_calibration(path)
        assert "\n" not in str(caught.value)


def test_a_calibration_file_is_found_beside_the_robot(log: Path, tmp_path: Path) -> None:
    text = yaml.safe_dump({**CALIBRATION, "distortion_coefficients": {"data": [0, 0, 0, "1e-05"]}})
    (tmp_path / "ost.yaml").write_text(text)
    assert read_calibration(tmp_path / "ost.yaml").coefficients == (0.0, 0.0, 0.0, 1e-5), "which YAML reads as text"
    robot = {
        "wheels": {"radius_m": 0.033, "track_m": 0.16, "lag_s": 0.05},
        "camera": {"topic": CAMERA, "file": "ost.yaml"},
    }
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(robot))
    main(["import", str(log), "--config", str(tmp_path / "robot.yaml"), "--out", str(tmp_path / "mine")])
    assert read_json(tmp_path / "mine" / "manifest.json")["log"]["camera"]["model"] == "fisheye"
    (tmp_path / "ost.yaml").write_text("image_width: 96\n")
    with pytest.raises(SystemExit):
        main(["import", str(log), "--config", str(tmp_path / "robot.yaml"), "--out", str(tmp_path / "other")])
