"""The log of a drive: its topics, its times, what it shares with the recording, and how it is written."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from sim.errors import InputError
from sim.files.checksums import write_arrays, write_json
from sim.recording.collect import collect
from sim.recording.format import open_recording, open_truth
from sim.recording.renderers import Part
from sim.robot.model import WHEEL_RADIUS_M
from sim.robot_log import log as writing
from sim.robot_log.log import check_log, robot_file, write_log, write_robot
from sim.robot_log.observe import EPOCH_NS, Observed, make_base_clock
from sim.settings import CameraMountSettings, DriveSettings, EncoderSettings, ImageFaultSettings, SimSettings

SEED, SAMPLES = 3, 16
IMAGE = "/camera/image_raw/compressed"


class Message(NamedTuple):
    logged: int
    stamp: int
    content: Any


Log = dict[str, list[Message]]


def quiet(*_: object) -> None:
    pass


def read(path: Path) -> Log:
    """Messages of each topic in the file's order."""
    found = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, logged, raw in reader.messages():
            content: Any = reader.deserialize(raw, connection.msgtype)
            stamp = (content if hasattr(content, "header") else content.transforms[0]).header.stamp
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
    write_log(path, settings, SEED, recording, "key", quiet, workers=1)
    return path


@pytest.fixture(scope="module")
def log(path: Path) -> Log:
    return read(path)


def times(log: Log, topic: str) -> np.ndarray:
    """Times of a topic's stamps in the simulation [s]."""
    clock = make_base_clock(SEED) if topic.startswith(("/joint", "/range")) else None
    stamp = np.array([message.stamp for message in log[topic]]) - EPOCH_NS
    return (stamp / 1e9 - clock.offset_s) / (1 + clock.drift) if clock else stamp / 1e9


def test_it_has_the_topics_of_such_a_robot(log):
    rays = [topic for topic in log if topic.startswith("/range/ray_")]
    others = {"/joint_states", IMAGE, "/camera/camera_info", "/tf", "/tf_static", "/ground_truth/pose"}
    assert set(log) == others | set(rays)
    assert len(rays) == 29
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
        for topic in ("/joint_states", "/range/ray_left_00", IMAGE, "/ground_truth/pose")
    }
    assert abs(apart["/joint_states"] - apart["/range/ray_left_00"]) < 0.01
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


def test_velocity_is_that_of_the_rims_as_turtlebot3_has_it(log):
    angle = np.array([message.content.position for message in log["/joint_states"]])
    speed = np.array([message.content.velocity for message in log["/joint_states"]])
    np.testing.assert_allclose(np.diff(angle, axis=0) * WHEEL_RADIUS_M / 0.05, speed[1:], atol=1e-9)


def test_the_truth_is_that_of_the_recording_and_the_same_on_both_topics(log, recording):
    time = times(log, "/ground_truth/pose")
    place = np.array([[one.content.pose.position.x, one.content.pose.position.y] for one in log["/ground_truth/pose"]])
    moved = [one.content.transforms[0].transform.translation for one in log["/tf"]]
    np.testing.assert_array_equal(place, [[one.x, one.y] for one in moved])
    sensed, truth = open_recording(recording), open_truth(recording)
    there = np.column_stack([np.interp(sensed.time[1:], time, axis) for axis in place.T])
    np.testing.assert_allclose(there, truth.pose[sensed.reading[1:, 1], :2], atol=0.002)


def test_a_ray_that_meets_nothing_is_infinite_and_each_has_its_frame(log):
    (sent,) = log["/tf_static"]
    angle = {
        one.child_frame_id: 2 * np.degrees(np.arctan2(one.transform.rotation.z, one.transform.rotation.w))
        for one in sent.content.transforms
    }
    assert angle.pop("camera") == pytest.approx(90)
    for frame, degrees in angle.items():
        side = -1 if "right" in frame else 1
        assert degrees == pytest.approx(side * int(frame[-2:]), abs=0.5)
        ranges = np.array([message.content.range for message in log[f"/range/{frame}"]])
        assert ((ranges < 3.5) | np.isinf(ranges)).all()
        assert log[f"/range/{frame}"][0].content.header.frame_id == frame


@pytest.mark.slow
def test_it_has_the_same_bytes_on_any_number_of_cores(path, settings, recording, tmp_path):
    write_log(tmp_path / "again.mcap", settings, SEED, recording, "key", quiet, workers=2)
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()
    assert {one.name for one in tmp_path.iterdir()} == {"again.mcap", "again.robot.yaml"}


class ToyRenderers:
    """Writes parts whose pictures are drawn by nobody: their numbers, as bytes."""

    def __init__(self, *_: object) -> None:
        pass

    def __enter__(self) -> "ToyRenderers":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def give(self, part: Part) -> None:
        count = len(part.states)
        write_arrays(part.path, {"jpeg": np.arange(9 * count, dtype=np.uint8), "end": 9 * np.arange(1, count + 1)})

    def finish(self, tell: Callable[[int], None]) -> None:
        tell(0)


def observe_toy() -> Observed:
    """What is observed of a robot that drives ahead for ten seconds, with pictures and rays of the first one."""
    fast, slow = np.arange(0.05, 10.0, 0.05), np.arange(0.1, 1.0, 0.1)
    ahead = np.column_stack([0.2 * fast, np.zeros((len(fast), 2))])
    angle = 6.0 * np.column_stack([fast, fast]) - 6.0 * fast[0]
    return Observed(fast, angle, slow, np.zeros((len(slow), 9)), slow, np.ones((len(slow), 29)), fast, ahead)


Write = Callable[..., Path]


@pytest.fixture(params=["toy", pytest.param("real", marks=pytest.mark.slow)])
def write(
    request: pytest.FixtureRequest, settings: SimSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Write:
    """Writes the log of the drive, or of a toy of it, into a folder and returns its path."""
    recording = tmp_path
    if request.param == "toy":
        monkeypatch.setattr(writing, "TracedWorld", lambda given: SimpleNamespace(settings=given))
        monkeypatch.setattr(writing, "_drive", lambda *_: observe_toy())
        monkeypatch.setattr(writing, "Renderers", ToyRenderers)
    else:
        recording = request.getfixturevalue("recording")

    def write(name: str, key: str = "key", progress: Callable[..., None] = quiet, **changes: Any) -> Path:
        path = tmp_path / name / "a.mcap"
        write_log(path, settings.model_copy(update=changes), SEED, recording, key, progress, workers=1)
        return path

    return write


def list_names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_interrupted_work_is_continued_and_says_so(write, tmp_path, caplog, monkeypatch):
    def stop(stage: str, *_: int) -> None:
        if stage == "log write":
            raise KeyboardInterrupt

    whole = write("whole")
    with pytest.raises(KeyboardInterrupt):
        write("cut", progress=stop)
    assert not (tmp_path / "cut" / "a.mcap").exists()
    part = tmp_path / "cut" / "a.mcap.parts" / "picture-000000.npz"
    part.write_bytes(part.read_bytes()[:-100])
    asked, there = [], sum(file.stat().st_size for file in part.parent.iterdir())
    monkeypatch.setattr(writing, "check_space", lambda _, needed: asked.append(needed))
    path = write("cut")
    pictures = writing.PICTURE_BYTES * len(read(path)[IMAGE])
    assert asked == [2 * pictures - there]
    assert "a.mcap.parts holds the beginning of this log: it is continued" in caplog.text
    assert path.read_bytes() == whole.read_bytes()
    assert list_names(path.parent) == {"a.mcap", "a.robot.yaml"}


def test_two_processes_cannot_write_one_log(write):
    def write_again(stage: str, *_: int) -> None:
        if stage == "log write":
            with pytest.raises(InputError, match=r"--log .*a\.mcap is being written by another process"):
                write("a", "other")

    path = write("a", progress=write_again)
    assert path.read_bytes() == write("b").read_bytes()
    assert list_names(path.parent) == {"a.mcap", "a.robot.yaml"}


def test_parts_of_another_log_are_not_used(write, tmp_path, caplog):
    parts = tmp_path / "a" / "a.mcap.parts"
    write_arrays(parts / "picture-000000.npz", {"jpeg": np.zeros(3, np.uint8), "end": np.array([3])})
    write_json(parts / "log.json", {"key": "other"})
    path = write("a")
    assert "a.mcap.parts holds the beginning of another log: this one is started again" in caplog.text
    assert path.read_bytes() == write("b").read_bytes()


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


@pytest.mark.slow
def test_a_log_in_the_place_of_another_has_pictures_of_its_own(settings, recording, tmp_path):
    pictures = []
    for roll_deg in (0.0, 10.0):
        leaning = settings.model_copy(update={"camera_mount": CameraMountSettings(roll_deg=roll_deg)})
        write_log(tmp_path / "a.mcap", leaning, SEED, recording, f"{roll_deg}", quiet, workers=1)
        pictures.append([message.content.data.tobytes() for message in read(tmp_path / "a.mcap")[IMAGE]])
    assert not set(pictures[0]) & set(pictures[1])


def test_the_description_of_the_robot_names_topics_of_the_log(path, log):
    robot = yaml.safe_load(path.with_suffix(".robot.yaml").read_text())
    topics = [robot["wheels"]["topic"], robot["camera"]["topic"], robot["camera"]["info"], robot["pose"]["topic"]]
    assert set(topics) <= set(log)
    assert log["/joint_states"][0].content.name == [robot["wheels"]["left"], robot["wheels"]["right"]]


def test_a_foreign_description_is_kept(settings, recording, tmp_path):
    (tmp_path / "a.robot.yaml").write_text("mine: 1")
    with pytest.raises(InputError, match=r"a.robot.yaml exists, and deepgps did not write it"):
        check_log(tmp_path / "a.mcap", settings)


def test_the_log_of_another_drive_is_refused(settings, recording, tmp_path):
    with pytest.raises(InputError, match="holds another drive than its settings give"):
        write_log(tmp_path / "a.mcap", settings, SEED + 1, recording, "key", quiet, workers=1)


def test_what_cannot_be_logged_is_said_before_any_work(settings, tmp_path):
    for name, content, changes, message in (
        ("a.bag", None, {}, "the name of a log must end in .mcap"),
        ("a.mcap", b"holiday", {}, "deepgps did not write it"),
        ("a.mcap", b"\x89MCAP0\r\nby others", {}, "deepgps did not write it"),
        ("b.mcap", None, {"sensor": "lidar"}, "needs world room and sensor fisheye"),
        ("b.mcap", None, {"image_faults": ImageFaultSettings(exposure=0.5)}, "image_faults applies to polar images"),
        ("b.mcap", None, {"drive": DriveSettings(mixed_light=True)}, "drive.mixed_light applies to polar images"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=message):
            check_log(tmp_path / name, settings.model_copy(update=changes))
        assert content is None or (tmp_path / name).read_bytes() == content


@pytest.mark.parametrize("edit", [lambda text: text + "# mine\n", lambda text: text.replace("estimate", "0.061")])
def test_a_description_of_the_robot_that_was_edited_is_not_overwritten(settings, tmp_path, edit):
    path = tmp_path / "a.mcap"
    for _ in range(2):  # what deepgps wrote may be written again
        check_log(path, settings)
        write_robot(path, settings)
    file = robot_file(path)
    file.write_text(edited := edit(file.read_text()))
    with pytest.raises(InputError, match=r"a\.robot\.yaml was edited, .* move it away, or give the log another name"):
        check_log(path, settings)
    assert file.read_text() == edited
