"""Logs of a synthetic robot, in every container and with every fault, become right recordings or are refused."""

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepgps.diagnosis.diagnosis import can_diagnose, diagnose
from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.drive import find_drive
from deepgps.robot_io.logs.importing import import_log
from deepgps.robot_io.logs.messages import open_wheels
from deepgps.robot_io.logs.pictures import open_images
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.recording.format import Recording, check_recording, has_truth, open_labels, open_recording, open_truth
from tests.helpers import robot_log
from tests.helpers.robot_log import (
    CAMERA,
    CAMERA_INFO,
    COMPRESSED,
    CONFIG,
    JOINTS,
    LENGTHS_M,
    RADIUS_M,
    TICK,
    TRUTH,
    TURNS,
    Note,
    change,
    encode,
    make_notes,
    make_texture,
    replace_pixels,
    seconds,
    set_fields,
    sort,
    write_log,
    write_plain,
)

FORMS = ("bag", "bag_bz2", "bag_lz4", "db3", "db3_v8", "db3_v5", "db3_zstd", "mcap", "mcap_zstd", "mcap_lz4")
slow = pytest.mark.slow
Change = Callable[[list[Note]], list[Note]]
WITH_TRUTH = {**CONFIG, "pose": {"topic": TRUTH}, "drive": {"spacing_m": 0.1, "held_out": 0.0}}


def in_tiers(cases: Iterable[str], *quick: str) -> list[Any]:
    """All cases, those that are not named marked slow."""
    return [case if case in quick else pytest.param(case, marks=slow) for case in cases]


@pytest.fixture(scope="module")
def notes() -> list[Note]:
    return make_notes("image/jpeg")


def configure(**groups: Any) -> RobotConfig:
    """The configuration with some settings of its groups replaced."""
    values = dict(WITH_TRUTH)
    for name, given in groups.items():
        values[name] = {**values.get(name, {}), **given} if isinstance(given, dict) else given
    return RobotConfig.model_validate(values)


PLAIN_CONFIG = configure(
    wheels={"topic": "wheels.csv", "left": "left", "right": "right", "lag_s": 0.0},
    camera={"topic": "images", "info": None, "circle_px": 38.0, "field_of_view_deg": 136.1},
    pose={"topic": "poses.csv"},
)


def bring_in(log: Path, tmp_path: Path, config: RobotConfig | None = None) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path / "recording"
    about = import_log(log, config or configure(), folder, ignore)
    check_recording(folder)
    return folder, about


def measure(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Length of each segment by ticks and by the truth (S,), (S,) [m]."""
    recording, pose = open_recording(folder), open_truth(folder).pose
    lengths = []
    for number in np.unique(recording.reading[:, 0]):
        rows = recording.reading[recording.reading[:, 0] == number]
        by_ticks = (rows[-1, 2:] - rows[0, 2:]).mean() * TICK * RADIUS_M
        lengths.append((by_ticks, np.linalg.norm(pose[rows[-1, 1], :2] - pose[rows[0, 1], :2])))
    by_ticks, true = np.array(lengths).T
    return by_ticks, true


def check_complete(folder: Path, within_m: float = 0.003) -> None:
    """Every segment and turn of the drive is there, and its length is right."""
    by_ticks, true = measure(folder)
    np.testing.assert_allclose(by_ticks, LENGTHS_M, atol=within_m)
    np.testing.assert_allclose(by_ticks, true, atol=within_m)
    turns = open_recording(folder).turns
    assert turns is not None and turns.kind.tolist() == [0] * len(TURNS) and (turns.image >= 0).all()


@pytest.mark.parametrize("form", in_tiers(FORMS, "bag", "db3", "mcap_lz4"))
def test_every_container_gives_the_same_recording(form: str, notes: list[Note], tmp_path: Path) -> None:
    folder, about = bring_in(write_log(tmp_path / "log", notes, form), tmp_path)
    check_complete(folder)
    assert about["notes"] == [] and open_recording(folder).manifest.source == "log"
    images = open_recording(folder).observation
    assert images.shape == (len(images), 16, 64, 3) and images.std() > 20


def test_a_plain_folder_is_a_log(tmp_path: Path) -> None:
    log = write_plain(tmp_path / "plain")
    folder, _ = bring_in(log, tmp_path, PLAIN_CONFIG)
    check_complete(folder)


@slow
def test_what_is_odd_in_a_plain_folder_is_passed_over_and_noted(tmp_path: Path) -> None:
    log = write_plain(tmp_path / "plain")
    first = min((log / "images").iterdir())
    (log / "images" / f"._{first.name}").write_bytes(b"\0\5\x16\7")
    head, *rows = (log / "wheels.csv").read_text().splitlines()
    rows[100] = f"{rows[100].partition(',')[0]},nan,"
    (log / "wheels.csv").write_text("\n".join([head, *rows, "33.4,1"]))
    first_pose, *poses = (log / "poses.csv").read_text().splitlines()
    poses[200:203] = [f"{poses[200].partition(',')[0]},{values}" for values in ("nan,nan,nan", "1,inf,0", "1,1,inf")]
    (log / "poses.csv").write_text("\n".join([first_pose, *poses]))
    folder, about = bring_in(log, tmp_path, PLAIN_CONFIG)
    check_complete(folder)
    assert any("poses.csv: 3 messages are left out" in note for note in about["notes"])
    (log / "wheels.csv").write_text("\n".join([head, *rows[: 3 * len(rows) // 4]]))
    _, about = bring_in(log, tmp_path / "shorter", PLAIN_CONFIG)
    assert any("images were taken before or after the wheels were logged" in note for note in about["notes"])


def test_a_plain_file_that_cannot_be_read_is_named_with_its_line(tmp_path: Path) -> None:
    log = write_plain(tmp_path / "plain")
    sound = (log / "wheels.csv").read_bytes()
    for data, message in (
        (b"time_s,left_rad,right_rad\n0.0,0.0,one\n0.1,0.0,0.0\n", r"wheels\.csv: line 2 must be time_s,left_rad"),
        (sound + b"\xff" * 9000, r"wheels\.csv must be text in UTF-8: after line \d+"),
        (sound + b"1" * 140_000, r"wheels\.csv: line \d+: field larger"),
    ):
        (log / "wheels.csv").write_bytes(data)
        with pytest.raises(InputError, match=message):
            bring_in(log, tmp_path / "new" / "folder", PLAIN_CONFIG)
        assert not (tmp_path / "new").exists(), "a refused import leaves nothing"


def test_images_that_are_named_by_their_numbers_are_refused(tmp_path: Path) -> None:
    for first, without in ((0, None), (1, None), (0, 7)):
        log = write_plain(tmp_path / f"plain{first}{without}")
        images = sorted((log / "images").iterdir(), key=lambda path: float(path.stem))
        for number, path in enumerate(images, start=first):
            path.rename(log / "images" / f"frame{number:06d}.png")
        for number, path in enumerate(sorted((log / "images").iterdir()), start=first):
            path.unlink() if number == without else path.rename(path.with_name(path.name.removeprefix("frame")))
        with pytest.raises(InputError, match=r"named by their numbers, 00000\d to 000\d+, which are no times"):
            bring_in(log, tmp_path, PLAIN_CONFIG)


def rename_images(log: Path, name: Callable[[float], str]) -> None:
    """Name each image by a function of its time [s]."""
    for path in (log / "images").iterdir():
        path.rename(path.with_name(f"{name(float(path.stem))}.png"))


def list_images(log: Path, name: Callable[[float], str]) -> None:
    """List the images in images.csv under a function of their times [s]."""
    rows = [f"{name(float(path.stem))},{path.name}" for path in sorted((log / "images").iterdir())]
    (log / "images.csv").write_text("\n".join(["time_s,file", *rows]))


def change_table(log: Path, table: str, name: Callable[[float], str]) -> None:
    """Replace the times of a table [s] by a function of them."""
    head, *rows = (log / table).read_text().splitlines()
    rows = [f"{name(float(time))},{rest}" for time, _, rest in (row.partition(",") for row in rows)]
    (log / table).write_text("\n".join([head, *rows]))


def times_of(path: Path) -> list[int]:
    with open_log(path) as log:
        return [sample.stamp_ns for sample, _ in log.read(list(log.types))]


def test_times_of_plain_files_in_another_unit_are_refused_in_one_line(tmp_path: Path) -> None:
    for unit in (1e3, 1e6, 1e9):

        def since_1970(time_s: float, unit: float = unit) -> str:
            return str(round((1.7e9 + time_s) * unit))

        log = write_plain(tmp_path / f"{unit}")
        for table in ("wheels.csv", "poses.csv"):
            sound = (log / table).read_text()
            change_table(log, table, since_1970)
            with pytest.raises(InputError, match=rf"{table}: line 2: time_s '17\d+' must be seconds; is it in ms"):
                times_of(log)
            (log / table).write_text(sound)
        list_images(log, since_1970)
        with pytest.raises(InputError, match=r"images\.csv: line 2: time_s '17\d+' must be seconds; is it in ms or ns"):
            times_of(log)
        (log / "images.csv").unlink()
        rename_images(log, since_1970)
        if unit == 1e9:
            assert max(times_of(log)) > 1.7e18
        else:
            with pytest.raises(InputError, match=r"17\d+\.png: its name must be seconds, or nanoseconds since 1970, "):
                times_of(log)


def test_names_may_be_nanoseconds_since_the_robot_started(tmp_path: Path) -> None:
    log = write_plain(tmp_path / "plain")
    times = times_of(log)
    rename_images(log, lambda time_s: f"{round(time_s * 1e9):016d}")
    assert times_of(log) == times


@slow
def test_split_files_in_a_folder_are_one_log(notes: list[Note], tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    for number, part in enumerate(np.array_split(np.arange(len(notes)), 11)):
        some = [notes[row] for row in part]
        write_log(tmp_path / "log" / f"drive_{number}", some, "mcap_lz4")
    (tmp_path / "log" / "drive_11.mcap").touch()
    (tmp_path / "log" / "._drive_0.mcap").write_bytes(b"\0\5\x16\7 of macOS")
    folder, _ = bring_in(tmp_path / "log", tmp_path)
    check_complete(folder)


def swap(_: int, note: Note) -> Note:
    return set_fields(note, name=note.fields["name"][::-1], position=note.fields["position"][::-1].copy())


def prefix(_: int, note: Note) -> Note:
    return set_fields(note, name=[f"tb3_0/{name}" for name in note.fields["name"]])


def wrap_angle(_: int, note: Note) -> Note:
    return set_fields(note, position=(note.fields["position"] + np.pi) % (2 * np.pi) - np.pi)


def in_bursts(number: int, note: Note) -> Note:
    """The messages of 0.8 s arrive together, in reverse order."""
    return replace(note, log_ns=note.log_ns + (15 - number % 16) * 51_000_000)


def lose_some(number: int, note: Note) -> Note:
    """Some messages hold one wheel, none, or a name too many."""
    name, position = note.fields["name"], note.fields["position"]
    cut = {3: position[:1], 7: position[:0]}.get(number % 11, position)
    return (
        set_fields(note, name=[*name, "arm"], position=cut)
        if number % 11 != 5
        else set_fields(note, name=["arm"], position=[0.3])
    )


def no_stamp(_: int, note: Note) -> Note:
    return replace(note, stamp_ns=0)


def late_images(_: int, note: Note) -> Note:
    return replace(note, stamp_ns=note.stamp_ns + 3_200_000_000)


def set_back(_: int, note: Note) -> Note:
    return replace(note, stamp_ns=note.stamp_ns - 400_000_000 * (seconds(note) > 15.0))


def scale(left: float, right: float) -> Change:
    """The wheels' angles multiplied by a factor for each."""
    return on(JOINTS, lambda _, note: set_fields(note, position=note.fields["position"] * np.array([left, right])))


def on(topic: str, fault: Callable[[int, Note], Note | None]) -> Change:
    return lambda notes: change(notes, topic, fault)


def lose(topic: str, begin_s: float, end_s: float) -> Change:
    """Without the messages of a topic between two times."""
    return on(topic, lambda _, note: None if begin_s < seconds(note) < end_s else note)


def show(how: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda notes: replace_pixels(notes, how)


def add_early_info(notes: list[Note]) -> list[Note]:
    """A calibration without numbers comes before the true ones."""
    first = next(note for note in notes if note.topic == CAMERA_INFO)
    return [set_fields(replace(first, log_ns=first.log_ns - 10**8), focal=0.0), *notes]


def begin_small(number: int, note: Note) -> Note:
    """The camera's first image has another size."""
    return note if number else replace(note, fields=encode(np.zeros((64, 64, 3), np.uint8), "image/jpeg"))


def damage(*numbers: int) -> Change:
    """The images of these numbers are cut off."""
    return on(CAMERA, lambda n, note: set_fields(note, data=note.fields["data"][:20]) if n in numbers else note)


def add_publisher(notes: list[Note]) -> list[Note]:
    """Another program publishes zeros for the same joints."""
    more = [replace(note, log_ns=note.log_ns + 10**7, stamp_ns=note.stamp_ns + 10**7) for note in notes]
    return sort([*notes, *(set_fields(note, position=np.zeros(2)) for note in more if note.topic == JOINTS)])


def restart(notes: list[Note]) -> list[Note]:
    """The wheels' counter begins at zero again after 14 s."""
    last = [note.fields["position"] for note in notes if note.topic == JOINTS and seconds(note) < 14.0][-1]
    return change(
        notes,
        JOINTS,
        lambda _, note: set_fields(note, position=note.fields["position"] - last * (seconds(note) >= 14.0)),
    )


def alike(notes: list[Note]) -> list[Note]:
    """Both wheels' angles are integrated from one wheel's."""
    return on(JOINTS, lambda _, note: set_fields(note, position=note.fields["position"][[0, 0]]))(notes)


def freeze(notes: list[Note]) -> list[Note]:
    """All images after the 150th are the same."""
    images = [note.fields for note in notes if note.topic == CAMERA]
    return change(notes, CAMERA, lambda number, note: replace(note, fields=images[min(number, 150)]))


def keep(notes: list[Note]) -> list[Note]:
    return notes


MIRRORED, ESTIMATED = {"camera": {"mirrored": True}}, {"wheels": {"lag_s": "estimate"}}
TOLERATED_CHANGES: dict[str, tuple[Change, dict[str, Any], float, str]] = {
    "swapped": (on(JOINTS, swap), {}, 0.003, ""),
    "namespace": (on(JOINTS, prefix), {}, 0.003, ""),
    "wraps": (on(JOINTS, wrap_angle), {}, 0.003, "a counter wrapped around"),
    "out of order": (on(JOINTS, in_bursts), {}, 0.003, ""),
    "partial": (on(JOINTS, lose_some), {}, 0.004, "messages hold neither wheel"),
    "zero stamps": (on(CAMERA, no_stamp), {"clocks": "logged", **ESTIMATED}, 0.005, ""),
    "late images": (on(CAMERA, late_images), {"clocks": "logged", **ESTIMATED}, 0.005, ""),
    "mirrored": (show(lambda image: image[:, ::-1]), MIRRORED, 0.003, ""),
    "dark": (show(lambda image: image * 0), {}, 0.02, ""),
    "lid": (show(lambda image: make_texture()[:80, :96]), {}, 0.02, ""),
    "left backward": (scale(-1, 1), {"wheels": {"backward": "left"}}, 0.003, ""),
    "right backward": (scale(1, -1), {"wheels": {"backward": "right", "lag_s": "estimate"}}, 0.003, ""),
    "both backward": (scale(-1, -1), {"wheels": {"backward": "both"}}, 0.003, ""),
    "another size": (on(CAMERA, begin_small), {}, 0.003, ""),
    "early calibration": (add_early_info, {}, 0.003, ""),
    "damaged images": (damage(20, 120, 220, 320), {}, 0.003, ""),
}
"""What a log's messages may be like: the change, settings, error of lengths [m], and what is noted."""


@pytest.mark.parametrize("case", in_tiers(TOLERATED_CHANGES, "partial", "zero stamps"))
def test_habits_of_real_robots_change_nothing(case: str, notes: list[Note], tmp_path: Path) -> None:
    how, groups, within_m, note = TOLERATED_CHANGES[case]
    folder, about = bring_in(write_log(tmp_path / "log", how(notes), "mcap_lz4"), tmp_path, configure(**groups))
    check_complete(folder, within_m)
    assert note in " ".join(about["notes"]) and not any("backward" in one for one in about["notes"])


NOTED_CHANGES: dict[str, tuple[Change, dict[str, Any], str]] = {
    "clock set back": (on(JOINTS, set_back), {"clocks": "logged"}, ""),
    "wheels lost": (lose(JOINTS, 1.4, 3.18), {}, r"/joint_states at 1\..* no message for 1\.9 s while the robot moved"),
    "counter restarts": (restart, {}, r"/joint_states at 13\.9.* the counter restarted"),
    "images lost": (lose(CAMERA, 6.5, 8.3), {}, ""),
    "camera fails": (lose(CAMERA, 12.0, 18.0), {}, r"images cover 27 of 33 s of the drive, .* 6 s from 1[12]\.\d s on"),
    "camera stops": (on(CAMERA, lambda n, one: one if n < 250 else None), {}, r"images cover 25 of 33 s of the drive"),
    "frozen": (freeze, {}, "images do not turn.*is the camera frozen or covered there"),
    "four damaged": (damage(50, 51, 52, 53), {"drive": {"spacing_m": 0.02}}, ""),
    "lag": (keep, {"wheels": {"lag_s": 0.3}}, r"wheels\.lag_s is 0\.3 s, but the turns show 0\.0"),
    "track": (keep, {"wheels": {"track_m": 0.32}}, r"the wheels turn 0\.(49|5|51) times as far: check radius, track"),
    "view": (
        keep,
        {"camera": {"info": None, "circle_px": 240.0, "field_of_view_deg": 185.0}},
        "images reach 15 deg from the optical axis all around it, and polar images 92, .* black in part",
    ),
}
"""What divides or spoils a drive: the change, settings, and what is noted."""


@pytest.mark.parametrize("case", in_tiers(NOTED_CHANGES, "wheels lost"))
def test_what_spoils_a_drive_is_noted_and_lengths_are_right(case: str, notes: list[Note], tmp_path: Path) -> None:
    how, groups, note = NOTED_CHANGES[case]
    folder, about = bring_in(write_log(tmp_path / "log", how(notes), "mcap_lz4"), tmp_path, configure(**groups))
    assert re.search(note, " ".join(about["notes"]))
    if case not in {"lag", "track", "view"}:
        by_ticks, true = measure(folder)
        np.testing.assert_allclose(by_ticks, true, atol=0.005)
        assert by_ticks[:1] == pytest.approx(LENGTHS_M[:1], abs=0.01) or case == "wheels lost"
    turns = open_recording(folder).turns
    assert turns is not None and (case != "counter restarts" or (turns.kind == 2).sum() == 1)


@slow
def test_the_lag_is_measured_from_turns_by_any_clock(notes: list[Note], tmp_path: Path) -> None:
    log = write_log(tmp_path / "log", notes, "mcap_lz4")
    _, about = bring_in(log, tmp_path, configure(**ESTIMATED))
    assert abs(about["lag_s"] - 0.05) <= 0.008 and not any("do not turn" in note for note in about["notes"])
    late = write_log(tmp_path / "late", change(notes, CAMERA, late_images), "mcap_lz4")
    _, about = bring_in(late, tmp_path / "aligned", configure(clocks="logged", **ESTIMATED))
    assert abs(about["lag_s"] - 0.043) < 0.008  # images are logged 10 ms after their stamps, wheels 3 ms


@slow
def test_a_fast_camera_shows_the_lag_in_slow_turns_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draw_all = robot_log._draw_all
    monkeypatch.setattr(robot_log, "RATE_RPS", 0.4)
    monkeypatch.setattr(robot_log, "_draw_all", lambda _: draw_all(1 / 30))
    robot_log.make_motion.cache_clear()
    fast = make_notes("image/jpeg")
    robot_log.make_motion.cache_clear()
    _, about = bring_in(write_log(tmp_path / "log", fast, "mcap_lz4"), tmp_path, configure(**ESTIMATED))
    assert abs(about["lag_s"] - 0.05) <= 0.02


@slow
def test_a_robot_that_drove_backward_more_than_forward_is_noted(notes: list[Note], tmp_path: Path) -> None:
    """Swapped and reversed wheels turn as they should, and only their way is backward."""
    with open_log(write_log(tmp_path / "log", notes, "mcap_lz4")) as log:
        wheels, images = open_wheels(log, configure().wheels), open_images(log, CAMERA)
        log.feed({JOINTS: wheels.take, CAMERA: images.take}, ignore)
    assert find_drive(configure(), wheels, images, None).notes == ()
    for number, (left, right) in enumerate(wheels.angle.tolist()):
        wheels.values[2 * number], wheels.values[2 * number + 1] = -right, -left
    (note,) = find_drive(configure(), wheels, images, None).notes
    metres = f"{sum(LENGTHS_M):.1f} m backward and 0.0 m forward"
    assert note == f"{JOINTS}: the robot drove {metres}: do both wheels count forward?"


@slow
def test_an_odometry_can_take_the_place_of_joints(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log", make_notes("image/jpeg", odometry=True), "mcap_lz4")
    folder, about = bring_in(log, tmp_path)
    check_complete(folder)
    assert any("wheels are computed from the odometry" in note for note in about["notes"])
    with pytest.raises(InputError, match=r"wheels\.backward left must be none: /joint_states is an odometry"):
        bring_in(log, tmp_path / "again", configure(wheels={"backward": "left"}))
    recording = open_recording(folder)
    assert not can_diagnose(recording)
    with pytest.raises(InputError, match="its wheels were computed from an odometry, which cannot be diagnosed"):
        diagnose(recording)


@slow
def test_without_poses_there_is_no_truth_and_with_them_segments_are_held_out(notes: list[Note], tmp_path: Path) -> None:
    log = write_log(tmp_path / "log", notes, "mcap_lz4")
    folder, about = bring_in(log, tmp_path, configure(pose=None, drive={"held_out": 0.3}))
    assert not has_truth(folder) and not open_labels(folder) and not len(open_recording(folder).test_observation)
    kept, held_out = open_recording(folder), open_recording(folder / "use")
    assert (kept.manifest.segments, held_out.manifest.segments) == (len(LENGTHS_M) - 2, 2)
    assert len(held_out.observation) == about["held_out"] > 5 and held_out.turns is not None
    assert held_out.turns.image.tolist() == [0]
    assert about["images_used"] == sum(map(count_images, (kept, held_out)))
    labelled, _ = bring_in(log, tmp_path / "labelled", configure(pose={"use": "labels"}))
    labels = open_labels(labelled)
    assert not has_truth(labelled) and labels is not None and np.isfinite(labels.pose).all()
    few, _ = bring_in(log, tmp_path / "few", configure(pose=None, drive={"held_out": 0.01}))
    assert open_recording(few / "use").manifest.segments == 1, "errors could not be measured without"
    folder, about = bring_in(log, tmp_path / "again", configure(drive={"held_out": 0.3}))
    recording, truth = open_recording(folder), open_truth(folder)
    assert len(recording.test_observation) == len(truth.test_pose) == about["held_out"] > 5
    assert about["images_used"] == count_images(recording) + len(recording.test_observation)
    assert recording.manifest.segments == len(LENGTHS_M) - 2


def count_images(recording: Recording) -> int:
    return len(recording.observation) + (0 if recording.turn_observation is None else len(recording.turn_observation))


def info(**fields: Any) -> Callable[[int, Note], Note]:
    return lambda _, note: set_fields(note, **fields)


def none(_: int, note: Note) -> None:
    return None


REFUSED_LOGS: dict[str, tuple[Change, str]] = {
    "no calibration": (on(CAMERA_INFO, info(focal=0.0)), "/camera/camera_info: the camera is not calibrated .K is 0."),
    "model": (on(CAMERA_INFO, info(model="ocam")), "/camera/camera_info: distortion model 'ocam': must be equidistant"),
    "size": (on(CAMERA_INFO, info(height=81)), "/camera/camera_info: it is for 96 x 81 px, and images have 96 x 80"),
    "no info": (on(CAMERA_INFO, none), "camera.info /camera/camera_info: .* has no such topic"),
    "no camera": (on(CAMERA, none), "camera.topic /camera/image_raw: .* has no such topic"),
    "no pose": (on(TRUTH, none), "pose.topic /mocap/pose: .* has no such topic"),
    "joints": (on(JOINTS, info(name=["a", "b"])), "/joint_states has no position of a joint 'wheel_left_joint'"),
    "few": (on(JOINTS, lambda n, note: note if n < 5 else None), "/joint_states has 5 messages with both wheels"),
}
"""Logs that are refused before a picture is unwrapped: the change, and what is said."""
LATE_REFUSALS: dict[str, tuple[Change, str]] = {
    "still": (
        on(JOINTS, info(position=np.zeros(2))),
        "images turn by .* and the wheels never differ",
    ),
    "alike": (alike, r"images turn by \d+ deg in .* pairs, and the wheels never differ: do both joints move alike"),
    "rare": (on(JOINTS, lambda n, note: None if n % 10 else note), r"[1-9]\d* unknown; .* no message for 0\.5 s while"),
    "clocks": (
        on(CAMERA, late_images),
        r"clock of /camera/image_raw differs from that of /joint_states by \+3\.1.*; clocks: logged takes",
    ),
    "clock set back": (on(JOINTS, set_back), r"clock of /joint_states is set back by 0\.400 s at 1[45]\.\d s; clocks:"),
    "mirrored": (
        show(lambda image: image[:, ::-1]),
        r"turn against the wheels: camera\.mirrored is wrong",
    ),
    "degrees": (scale(180 / np.pi, 180 / np.pi), r"they turn 5[678] times as far as the images: .* radians"),
    "left": (scale(-1, 1), r"wheels\.left, wheels\.right: they turn against each other .* the left one"),
    "right": (scale(1, -1), r"wheels\.left, wheels\.right: they turn against each other .* the right one"),
    "backward": (scale(-1, -1), r"turn against the wheels: .* both wheels count backward \(wheels\.backward"),
    "damaged": (
        damage(*range(20, 334, 15)),
        r"/camera/image_raw at \d+\.\d+ s: .*picture is damaged; damaged",
    ),
    "two publishers": (add_publisher, r"/joint_states at \d+\.\d\d s: .* more than one program published"),
}
"""Logs whose drive or pictures are refused."""


def check_refused(how: Change, message: str, notes: list[Note], folder: Path) -> None:
    log = write_log(folder / "log", how(notes), "mcap_lz4")
    with pytest.raises(InputError, match=message) as caught:
        bring_in(log, folder)
    assert "\n" not in str(caught.value)
    assert [path.name for path in folder.iterdir()] == ["log.mcap"]


@pytest.mark.parametrize("case", in_tiers(REFUSED_LOGS, "model", "no camera", "joints", "few"))
def test_what_cannot_be_used_is_refused_in_one_line(case: str, notes: list[Note], tmp_path: Path) -> None:
    check_refused(*REFUSED_LOGS[case], notes, tmp_path)


@pytest.mark.parametrize("case", in_tiers(LATE_REFUSALS, "clocks", "mirrored", "two publishers"))
def test_what_contradicts_itself_is_refused_in_one_line(case: str, notes: list[Note], tmp_path: Path) -> None:
    check_refused(*LATE_REFUSALS[case], notes, tmp_path)


@slow
def test_a_topic_without_messages_is_refused(notes: list[Note], tmp_path: Path) -> None:
    others = [note for note in notes if note.topic != CAMERA]
    log = write_log(tmp_path / "log", others, "db3", empty=[(CAMERA, COMPRESSED)])
    with pytest.raises(InputError, match=r"camera\.topic /camera/image_raw holds no image"):
        bring_in(log, tmp_path)


def test_a_place_that_cannot_take_a_recording_is_refused_before_the_log_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("mine")
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    (tmp_path / "dangling").symlink_to("nothing")
    monkeypatch.chdir(tmp_path / "empty")
    for out, why in (
        (tmp_path / "full", "is not empty"),
        (tmp_path / "full" / "mine", "is not empty"),
        (tmp_path / "full" / "mine" / "x", "cannot be made: .*mine is no folder"),
        (tmp_path / "link", "is a link"),
        (tmp_path / "dangling", "is a link"),
        (Path("."), "is the working folder"),
        (tmp_path / "empty", "is the working folder"),
        (Path("/proc"), "is a mount point"),
    ):
        with pytest.raises(InputError, match=f"{why}; a recording is written to a folder of its own"):
            import_log(tmp_path / "no log", configure(), out, ignore)
