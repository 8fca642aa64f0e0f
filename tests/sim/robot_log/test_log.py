"""The log of a drive: its topics, its times, what it shares with the recording, and how it is written."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any, NamedTuple

import hypothesis
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from sim.errors import InputError
from sim.files.atomic import PART
from sim.recording.collect import collect
from sim.recording.format import open_recording, open_truth
from sim.robot.model import WHEEL_RADIUS_M
from sim.robot_log import log as writing
from sim.robot_log.log import check_log, robot_file, write_log, write_robot
from sim.robot_log.mcap_file import Topic, make_pose, read_key, write_mcap
from sim.robot_log.observe import EPOCH_NS, Trace, make_base_clock
from sim.settings import DriveSettings, EncoderSettings, ImageFaultSettings, SimSettings
from tests.helpers.recordings import quiet

SEED, SAMPLES = 3, 16
IMAGE = "/camera/image_raw/compressed"


class Message(NamedTuple):
    logged: int
    stamp: int
    content: Any


Log = dict[str, list[Message]]


def read(path: Path) -> Log:
    """Messages of each topic in the file's order."""
    found = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, logged, raw in reader.messages():
            content: Any = reader.deserialize(raw, connection.msgtype)
            stamp = content.header.stamp
            found[connection.topic].append(Message(logged, stamp.sec * 10**9 + stamp.nanosec, content))
    return found


@pytest.fixture(scope="module")
def settings(small_settings: SimSettings) -> SimSettings:
    return small_settings.model_copy(update={"drive": DriveSettings(samples=SAMPLES)})


@pytest.fixture(scope="module")
def recording(settings: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive") / "recording"
    collect(settings, SEED, folder, quiet, workers=1)
    return folder


@pytest.fixture(scope="module")
def path(settings: SimSettings, recording: Path) -> Path:
    path = recording.parent / "drive.mcap"
    write_log(path, settings, SEED, recording, "key", quiet)
    return path


@pytest.fixture(scope="module")
def log(path: Path) -> Log:
    return read(path)


def times(log: Log, topic: str) -> np.ndarray:
    """Times of a topic's stamps in the simulation [s]."""
    clock = make_base_clock(SEED) if topic.startswith("/joint") else None
    stamp = np.array([message.stamp for message in log[topic]]) - EPOCH_NS
    return (stamp / 1e9 - clock.offset_s) / (1 + clock.drift) if clock else stamp / 1e9


def test_it_has_the_topics_of_such_a_robot_and_its_description_names_them(path, log):
    assert set(log) == {"/joint_states", IMAGE, "/camera/camera_info", "/ground_truth/pose"}
    robot = yaml.safe_load(robot_file(path).read_text())
    wheels, camera, pose = (robot[name] for name in ("wheels", "camera", "pose"))
    assert {wheels["topic"], camera["topic"], camera["info"], pose["topic"]} <= set(log)
    assert log["/joint_states"][0].content.name == [wheels["left"], wheels["right"]]
    assert len(log[IMAGE]) == len(log["/camera/camera_info"]) == pytest.approx(len(log["/joint_states"]) / 2, abs=1.5)


def test_messages_are_in_the_order_in_which_they_were_recorded(log):
    for messages in log.values():
        logged, stamp = (np.array([getattr(message, name) for message in messages]) for name in ("logged", "stamp"))
        assert (np.diff(logged) >= 0).all()
        assert (np.diff(stamp) > 0).all()


def test_pictures_are_taken_all_the_time_and_the_wheels_read_too(log):
    for topic, period_s in (("/joint_states", 0.05), (IMAGE, 0.1), ("/ground_truth/pose", 0.05)):
        np.testing.assert_allclose(np.diff(times(log, topic)), period_s, atol=0.0051)


def test_the_wheels_clock_is_not_the_camera_s(log):
    apart = {
        topic: np.median([message.logged - message.stamp for message in log[topic]]) / 1e9
        for topic in ("/joint_states", IMAGE)
    }
    assert 0 < apart[IMAGE] < 0.05
    assert abs(apart["/joint_states"] - apart[IMAGE]) > 0.9


def test_wheels_are_whole_ticks_of_the_period_before(log, recording):
    """The recording's ticks, which are exact, lie between those of the log 50 ms later."""
    time = times(log, "/joint_states")
    ticks = np.array([message.content.position for message in log["/joint_states"]]) * 4096 / (2 * np.pi)
    np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-6)
    sensed = open_recording(recording)
    late = np.column_stack([np.interp(sensed.time[1:] + 0.05, time, wheel) for wheel in ticks.T])
    np.testing.assert_allclose(late, sensed.reading[1:, 2:], atol=12)  # 12 ticks: a physics step at full speed
    prompt = np.column_stack([np.interp(sensed.time[1:], time, wheel) for wheel in ticks.T])
    assert np.abs(prompt - sensed.reading[1:, 2:]).max() > 100
    rim_mps = np.array([message.content.velocity for message in log["/joint_states"]])  # as TurtleBot3 has it
    np.testing.assert_allclose(np.diff(ticks, axis=0) * WHEEL_RADIUS_M / 0.05 * np.pi / 2048, rim_mps[1:], atol=1e-9)


def test_the_truth_is_that_of_the_recording(log, recording):
    time = times(log, "/ground_truth/pose")
    place = np.array([[one.content.pose.position.x, one.content.pose.position.y] for one in log["/ground_truth/pose"]])
    sensed, truth = open_recording(recording), open_truth(recording)
    there = np.column_stack([np.interp(sensed.time[1:], time, axis) for axis in place.T])
    np.testing.assert_allclose(there, truth.pose[sensed.reading[1:, 1], :2], atol=0.002)


def trace_toy(*_: object) -> tuple[Trace, np.ndarray]:
    """A robot that drives ahead for ten seconds; its wheels do not turn before they are read."""
    time = np.arange(0.005, 10.0, 0.005)
    state = np.zeros((len(time), 9))
    state[:, 0], state[:, 3], state[:, 7:] = 0.2 * time, 1.0, 6.0 * np.maximum(time - 0.05, 0.0)[:, None]
    return Trace(time, state), np.zeros((3, 2))


def make_toy_world(settings: SimSettings) -> SimpleNamespace:
    joints = SimpleNamespace(joint=lambda name: SimpleNamespace(qposadr=[7 + ("right" in name)]))
    return SimpleNamespace(settings=settings, model=joints)


Write = Callable[..., Path]


@pytest.fixture
def write(settings: SimSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Writes the log of a toy of the drive into a folder and returns its path."""
    monkeypatch.setattr(writing, "TracedWorld", make_toy_world)
    monkeypatch.setattr(writing, "trace_drive", trace_toy)
    truth = SimpleNamespace(wheel_angle=np.zeros((2, 2)), pose=np.zeros((2, 3)))
    monkeypatch.setattr(writing, "open_truth", lambda _: truth)
    monkeypatch.setattr(writing, "open_camera", lambda _: lambda state, _: (1e3 * state[:3]).astype(np.uint8))

    def write(name: str, key: str = "key", progress: Callable[..., None] = quiet, **changes: Any) -> Path:
        path = tmp_path / name / "a.mcap"
        write_log(path, settings.model_copy(update=changes), SEED, tmp_path, key, progress)
        return path

    return write


def list_names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_interrupted_work_leaves_nothing_and_begins_again(write, tmp_path, monkeypatch):
    def stop(stage: str, *_: int) -> None:
        if stage == "log write":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write("cut", progress=stop)
    assert not (tmp_path / "cut" / "a.mcap").exists()
    (tmp_path / "cut" / f"a.mcap{PART}").mkdir()  # as a killed process leaves it
    path = write("cut")
    assert path.read_bytes() == write("whole").read_bytes()
    assert list_names(path.parent) == {"a.mcap", "a.robot.yaml"}


def test_two_processes_write_one_log_one_after_the_other(write, caplog):
    second = []

    def write_again(stage: str, *_: int) -> None:
        if stage == "log write" and not second:
            second.append(Thread(target=write, args=("a",)))  # by a lock of its own, as another process
            second[0].start()

    path = write("a", progress=write_again)
    second[0].join()
    assert path.read_bytes() == write("b").read_bytes()
    assert "is complete already" in caplog.text
    assert list_names(path.parent) == {"a.mcap", "a.robot.yaml"}


def test_a_complete_log_stays_and_one_of_other_settings_is_replaced(write, settings, caplog):
    path = write("a")
    before, content = path.stat().st_mtime_ns, path.read_bytes()
    check_log(path, settings)
    write("a")
    assert path.stat().st_mtime_ns == before
    assert "is complete already" in caplog.text
    write("a", "another key")
    assert path.read_bytes() != content
    assert len(read(path)[IMAGE]) == len(read(write("b"))[IMAGE])


def test_faults_of_the_encoders_are_in_the_log(write, settings):
    faults = EncoderSettings(radius_error_left=0.1, dropout=0.2)
    every, states = (
        read(write(name, **more))["/joint_states"] for name, more in (("a", {}), ("b", {"encoder": faults}))
    )
    assert 0.7 * len(every) < len(states) < 0.9 * len(every)
    sound = {message.stamp: message.content.position for message in every}
    expected = np.array([sound[message.stamp] for message in states]) * (1.1, 1.0)
    tick = 2 * np.pi / faults.ticks_per_rev
    np.testing.assert_allclose([message.content.position for message in states], expected, atol=3 * tick)


def test_the_log_of_another_drive_is_refused(settings, recording, tmp_path):
    with pytest.raises(InputError, match="holds another drive than its settings give"):
        write_log(tmp_path / "a.mcap", settings, SEED + 1, recording, "key", quiet)


def test_what_cannot_be_logged_is_said_before_any_work(settings, tmp_path):
    for name, content, changes, message in (
        ("a.bag", None, {}, "the name of a log must end in .mcap"),
        ("a.mcap", b"holiday", {}, "deepgps did not write it"),
        ("a.mcap", b"\x89MCAP0\r\nby others", {}, "deepgps did not write it"),
        ("b.mcap", None, {"sensor": "lidar"}, "needs world room and sensor fisheye"),
        ("b.mcap", None, {"image_faults": ImageFaultSettings(exposure=0.5)}, "image_faults applies to polar images"),
        ("b.mcap", None, {"drive": DriveSettings(mixed_light=True)}, "drive.mixed_light applies to polar images"),
        ("b.mcap", None, {"drive": DriveSettings(person=2)}, "drive.person applies to polar images"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=message):
            check_log(tmp_path / name, settings.model_copy(update=changes))
        assert content is None or (tmp_path / name).read_bytes() == content


def test_a_description_of_the_robot_that_was_edited_is_not_overwritten(settings, tmp_path):
    path = tmp_path / "a.mcap"
    for _ in range(2):  # what deepgps wrote may be written again
        check_log(path, settings)
        write_robot(path, settings)
    file = robot_file(path)
    for edited in (file.read_text() + "# mine\n", file.read_text().replace("estimate", "0.061"), "mine: 1"):
        file.write_text(edited)
        with pytest.raises(InputError, match=r"a\.robot\.yaml exists, and deepgps did not write it: .*move it away"):
            check_log(path, settings)
        assert file.read_text() == edited


logs = st.lists(st.lists(st.integers(0, 10**18), max_size=5), min_size=1, max_size=4)


@given(logs, st.from_regex("[0-9a-f]{1,8}", fullmatch=True))
@hypothesis.settings(max_examples=20)
def test_what_is_written_reads_back_the_same_and_the_key_is_found(tmp_path_factory, times, key):
    make = lambda row: make_pose(row, np.array([row, 0.1, 0.2]))  # noqa: E731
    topics = [Topic(f"/{name}", np.sort(np.array(logged, int)), make) for name, logged in enumerate(times)]
    path = tmp_path_factory.mktemp("mcap") / "a.mcap"
    write_mcap(path, topics, key, quiet)
    assert read_key(path) == key
    assert list_names(path.parent) == {"a.mcap"}
    with AnyReader([path]) as reader:
        found = [(one.topic, logged, bytes(raw)) for one, logged, raw in reader.messages()]
    store = get_typestore(Stores.ROS2_HUMBLE)
    written = [
        (one.name, int(logged), bytes(store.serialize_cdr(one.make(row), "geometry_msgs/msg/PoseStamped")))
        for one in topics
        for row, logged in enumerate(one.logged)
    ]
    assert found == sorted(written, key=lambda message: message[1])
