"""What a log holds is printed as a robot.yaml that imports it; the command and the file's errors."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deepgps.commands.main import main
from deepgps.robot_io.logs import containers
from deepgps.robot_io.logs.look import look
from deepgps.robot_io.logs.robot_config import load_config
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.files.checksums import read_json, sha256
from sim.recording.format import check_recording
from tests.helpers.robot_log import (
    CAMERA,
    CAMERA_INFO,
    JOINTS,
    START_NS,
    TRUTH,
    Note,
    change,
    make_notes,
    set_fields,
    sort,
    write_log,
    write_plain,
)


@pytest.fixture(scope="module")
def notes() -> list[Note]:
    return make_notes("image/jpeg")


@pytest.fixture(scope="module")
def log(notes: list[Note], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("look") / "log", notes, "mcap_lz4")


def look_at(folder: Path, notes: list[Note]) -> tuple[str, dict[str, Any]]:
    """What is said of the first second of some messages, and the values that are proposed."""
    some = [one for one in notes if one.log_ns < START_NS + 10**9]
    said = look(write_log(folder / "log", some, "mcap_lz4"), ignore)
    return said, yaml.safe_load(said)


def rename(notes: list[Note], *names: str) -> list[Note]:
    angles = np.zeros(len(names))
    return change(notes, JOINTS, lambda _, note: set_fields(note, name=[*names], position=angles))


def test_the_proposed_file_imports_the_log_when_what_is_open_is_given(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["import", str(log), "--look"])
    said = capsys.readouterr().out
    config = tmp_path / "robot.yaml"
    config.write_text(said)
    with pytest.raises(InputError, match=r"wheels\.radius_m None: must be"):
        load_config(config)
    for name, value in (("radius_m", 0.033), ("track_m", 0.16), ("height_m", 0.35), ("forward_deg", 0)):
        said = said.replace(f"{name}:  #", f"{name}: {value}  #")
    config.write_text(said)
    main(["import", str(log), "--config", str(config), "--out", str(tmp_path / "mine")])
    said = capsys.readouterr().out
    assert "5 segments" in said and "4 turns in place, 4 of them seen before and after" in said
    check_recording(tmp_path / "mine")
    manifest = read_json(tmp_path / "mine" / "manifest.json")
    assert manifest["source"] == "log" and manifest["log"]["config_sha256"] == sha256(config)
    assert manifest["settings"]["camera"]["field_of_view_deg"] == pytest.approx(143.24, abs=0.3)
    for words in (["--look", "--out", "x"], [], ["--out", "x"]):
        with pytest.raises(SystemExit) as ended:
            main(["import", "log.mcap", *words])
        said = capsys.readouterr().err
        assert ended.value.code == 2 and "--config FILE" in said and "--out FOLDER" in said


def test_messages_are_counted_while_a_log_is_read(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(containers, "STRIDE", 50)
    told: list[tuple[int, int]] = []
    look(log, lambda label, *done: told.append(done[:2]))
    total = told[0][1]
    assert total > 100
    assert told == [*((done, total) for done in range(0, total, 50)), (total, total)]


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
        "# one clock: /joint_states, /camera/image_raw, /mocap/pose",
    ):
        assert part in said
    found = yaml.safe_load(said)
    assert found["camera"] == {"topic": CAMERA, "info": CAMERA_INFO, "height_m": None, "forward_deg": None}
    assert found["pose"]["topic"] == TRUTH and found["clocks"] == "checked"


@pytest.mark.parametrize(
    ("names", "left", "right"),
    [
        (("drivewhl_l_joint", "drivewhl_r_joint"), "drivewhl_l_joint", "drivewhl_r_joint"),
        (("arm_right", "arm_left", "base/Wheel_Right", "base/Wheel_Left"), "base/Wheel_Left", "base/Wheel_Right"),
        (("l_wheel_joint", "motor_1", "r_wheel_joint"), "l_wheel_joint", "r_wheel_joint"),
        (("motor_1", "motor_2"), None, None),
    ],
)
def test_joints_are_proposed_by_their_sides_or_left_open(
    names: tuple[str, ...], left: str | None, right: str | None, notes: list[Note], tmp_path: Path
) -> None:
    said, found = look_at(tmp_path, rename(notes, *names))
    assert (found["wheels"]["left"], found["wheels"]["right"]) == (left, right)
    assert left or "left:  # one of motor_1, motor_2" in said


def test_only_the_odometry_of_the_wheels_is_proposed(notes: list[Note], tmp_path: Path) -> None:
    wheels = [one for one in make_notes("image/jpeg", odometry=True) if one.topic == JOINTS]
    others = [one for one in notes if one.topic != JOINTS]
    others += [
        replace(one, topic=topic)
        for one in wheels
        for topic in ("/camera/odom/sample", "/odom_rf2o", "/camera/w", "/dlio/odom", "/odometry/global", "/ekf/odom")
    ]
    said, found = look_at(tmp_path, sort([*others, *(replace(one, topic="/odom") for one in wheels)]))
    assert found["wheels"]["topic"] == "/odom"
    for other in ("/camera/odom/sample", "/camera/w", "/dlio/odom", "/ekf/odom", "/odom_rf2o", "/odometry/global"):
        assert other in re.findall(r"/odom  # it must be of the wheels alone, not (.*)", said)[0]
    said, found = look_at(tmp_path, sort(others))
    assert found["wheels"]["topic"] is None and "# /odom_rf2o is no odometry of wheels alone" in said


def test_what_cannot_be_used_is_left_open(notes: list[Note], tmp_path: Path) -> None:
    pose = next(note for note in notes if note.topic == TRUTH)
    goals = [replace(pose, topic="/goal_pose", log_ns=pose.log_ns + s * 10**8) for s in (1, 8)]
    odd = change(notes, CAMERA_INFO, lambda _, note: set_fields(note, focal=0.0))
    odd = change(odd, JOINTS, lambda _, note: set_fields(note, position=np.zeros(0)))
    odd = change(odd, CAMERA, lambda _, note: replace(note, stamp_ns=note.stamp_ns + 3 * 10**9))
    said, found = look_at(tmp_path, sort([*odd, *goals]))
    for part in (
        "not calibrated: K is 0",
        "circle_px:  # no calibration can be used: radius of the round picture, at most 40",
        "joints without positions: wheel_left_joint, wheel_right_joint",
        "topic:  # no positions of joints and no odometry of wheels are in the log",
        "# the clock of /mocap/pose differs from that of /camera/image_raw by -2.991 s at ",
    ):
        assert part in said
    assert found["pose"]["topic"] == TRUTH and found["clocks"] == "logged" and found["camera"]["circle_px"] is None


def test_a_plain_folder_is_looked_at(tmp_path: Path) -> None:
    found = yaml.safe_load(look(write_plain(tmp_path / "plain"), ignore))
    wheels, camera = found["wheels"], found["camera"]
    assert (wheels["topic"], wheels["left"], camera["topic"]) == ("wheels.csv", "left", "images")


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
    ):
        path.write_text(yaml.safe_dump({**base, **values}))
        with pytest.raises(InputError, match=message) as caught:
            load_config(path)
        assert "\n" not in str(caught.value)
    path.write_text(yaml.safe_dump({**base, "camera": {"topic": "/c", "file": "ost.yaml"}}))
    assert load_config(path).camera.file == tmp_path / "ost.yaml", "which is beside this one"
