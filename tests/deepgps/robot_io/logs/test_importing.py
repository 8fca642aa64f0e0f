"""Logs of a synthetic robot, in every container and with every fault, become right recordings or are refused."""

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepgps.diagnosis.diagnosis import can_diagnose, diagnose
from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.importing import import_log
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.recording.format import check_recording, has_truth, open_labels, open_recording, open_truth
from tests.helpers.robot_log import (
    CAMERA,
    CAMERA_INFO,
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
    seconds,
    set_fields,
    write_log,
    write_plain,
)

slow = pytest.mark.slow
Change = Callable[[list[Note]], list[Note]]
WITH_TRUTH = {**CONFIG, "pose": {"topic": TRUTH}, "drive": {"spacing_m": 0.1, "held_out": 0.0}}
ESTIMATED = {"wheels": {"lag_s": "estimate"}}


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


@pytest.mark.parametrize("form", ["bag", "db3_zstd", pytest.param("mcap", marks=slow), "mcap_lz4"])
def test_every_container_gives_the_same_recording(form: str, notes: list[Note], tmp_path: Path) -> None:
    folder, about = bring_in(write_log(tmp_path / "log", notes, form), tmp_path)
    check_complete(folder)
    assert about["notes"] == [] and open_recording(folder).manifest.source == "log"
    images = open_recording(folder).observation
    assert images.shape == (len(images), 16, 64, 3) and images.std() > 20


def test_a_plain_folder_is_a_log_and_what_is_odd_in_it_is_passed_over(tmp_path: Path) -> None:
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


def times_of(folder: Path, names: Sequence[str], listed: Sequence[str] = (), wheels: str = "0.1") -> list[int]:
    """Stamps [ns] in a folder with images of these names, perhaps listed with times, and a message of the wheels."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "images").mkdir(parents=True)
    for name in names:
        (folder / "images" / f"{name}.png").touch()
    text = f"time_s,left_rad,right_rad\n{wheels},0,0\n"
    (folder / "wheels.csv").write_text(text, encoding="utf-8", errors="surrogateescape")
    if listed:
        rows = [f"{time},{name}.png" for time, name in zip(listed, names, strict=True)]
        (folder / "images.csv").write_text("\n".join(["time_s,file", *rows]))
    with open_log(folder) as log:
        return [sample.stamp_ns for sample in log.read(list(log.types))]


def test_a_plain_file_that_cannot_be_read_is_named_with_its_line(tmp_path: Path) -> None:
    for rows, message in (
        ("0.0,0.0,one\n0.1", r"wheels\.csv: line 2 must be time_s,left_rad"),
        ("0.1,0,0\n\udcff" + "0" * 9000 + "\n1", r"wheels\.csv: line 3 must be time_s,left_rad"),
        ("0.1,0,0\n" + "1" * 140_000 + ",\n1", r"wheels\.csv: line 3 must be time_s,left_rad"),
    ):
        with pytest.raises(InputError, match=message):
            times_of(tmp_path / "log", ["1.5"], wheels=rows)


def test_images_are_named_by_times_and_not_by_numbers_or_in_another_unit(tmp_path: Path) -> None:
    assert times_of(tmp_path / "log", ["12.5", "0000012500001000"]) == [12_500_000_000, 12_500_001_000, 10**8]
    assert times_of(tmp_path / "log", [f"{17 * 10**17 + n}" for n in range(3)])[:2] == [17 * 10**17, 17 * 10**17 + 1]
    assert times_of(tmp_path / "log", ["a", "b"], ["1700000000.000000001", "2"])[0] == 2 * 10**9
    for first, step in ((0, 1), (1, 1), (0, 7)):
        with pytest.raises(
            InputError, match=r"0000\d\d\.png: its name is no time: .* list times and names in images.csv"
        ):
            times_of(tmp_path / "log", [f"{first + step * number:06d}" for number in range(9)])
    for unit in (1e3, 1e6, 1e9):
        late = f"{1.7e9 * unit:.0f}"
        with pytest.raises(InputError, match=r"wheels\.csv: line 2: time_s '17\d+' must be seconds; is it in ms or ns"):
            times_of(tmp_path / "log", ["1.5"], wheels=late)
        with pytest.raises(InputError, match=r"images\.csv: line 2: time_s '17\d+' must be seconds; is it in ms or ns"):
            times_of(tmp_path / "log", ["a"], [late])
        if unit < 1e9:
            with pytest.raises(
                InputError,
                match=r"17\d+\.png: its name is no time: it must be seconds with a point, such as 12\.345, or nanos",
            ):
                times_of(tmp_path / "log", [late])


def lose_some(number: int, note: Note) -> Note:
    """Some messages hold one wheel, none, or a name too many."""
    name, position = note.fields["name"], note.fields["position"]
    cut = {3: position[:1], 7: position[:0]}.get(number % 11, position)
    return (
        set_fields(note, name=[*name, "arm"], position=cut)
        if number % 11 != 5
        else set_fields(note, name=["arm"], position=[0.3])
    )


def on(topic: str, fault: Callable[[int, Note], Note | None]) -> Change:
    return lambda notes: change(notes, topic, fault)


def lose(topic: str, begin_s: float, end_s: float) -> Change:
    """Without the messages of a topic between two times."""
    return on(topic, lambda _, note: None if begin_s < seconds(note) < end_s else note)


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


def restart(notes: list[Note]) -> list[Note]:
    """The wheels' counter begins at zero again after 14 s."""
    last = [note.fields["position"] for note in notes if note.topic == JOINTS and seconds(note) < 14.0][-1]
    return change(
        notes,
        JOINTS,
        lambda _, note: set_fields(note, position=note.fields["position"] - last * (seconds(note) >= 14.0)),
    )


def delay(_: int, note: Note) -> Note:
    return replace(note, stamp_ns=note.stamp_ns + 10**8)


def alike(notes: list[Note]) -> list[Note]:
    """Both wheels' angles are integrated from one wheel's."""
    return on(JOINTS, lambda _, note: set_fields(note, position=note.fields["position"][[0, 0]]))(notes)


def test_habits_of_real_robots_change_nothing(notes: list[Note], tmp_path: Path) -> None:
    """A first image of another size, a calibration without numbers, damaged images, joints that are missing."""
    odd = on(JOINTS, lose_some)(on(CAMERA, begin_small)(damage(20, 120, 220, 320)(add_early_info(notes))))
    folder, about = bring_in(write_log(tmp_path / "log", odd, "mcap_lz4"), tmp_path, configure(**ESTIMATED))
    check_complete(folder, 0.004)
    assert abs(about["lag_s"] - 0.05) <= 0.008 and "; damaged images: " in about["notes"][-1]


NOTED_CHANGES: dict[str, tuple[Change, dict[str, Any], str]] = {
    "wheels lost": (
        lose(JOINTS, 1.4, 3.18),
        {},
        r"/joint_states: at 1\..* no message for up to 1\.9 s while the robot moved",
    ),
    "counter restarts": (restart, {}, r"/joint_states: at 13\.9.* the counter restarted"),
    "camera fails": (
        lose(CAMERA, 12.0, 18.0),
        {},
        r"images cover 27 of 33 s of the drive, at most 6 s in a row are missing",
    ),
    "poses late": (on(TRUTH, delay), {}, r"poses come \+(9|10|11)\d? ms later than images"),
    "view": (
        lambda notes: notes,
        {"camera": {"info": None, "circle_px": 240.0, "field_of_view_deg": 185.0}},
        "images reach 15 deg from the optical axis all around it, and polar images 92, .* black in part",
    ),
}
"""What divides or spoils a drive: the change, settings, and what is noted."""


@pytest.mark.parametrize(
    "case", [case if case == "poses late" else pytest.param(case, marks=slow) for case in NOTED_CHANGES]
)
def test_what_spoils_a_drive_is_noted_and_lengths_are_right(case: str, notes: list[Note], tmp_path: Path) -> None:
    how, groups, note = NOTED_CHANGES[case]
    folder, about = bring_in(write_log(tmp_path / "log", how(notes), "mcap_lz4"), tmp_path, configure(**groups))
    assert re.search(note, " ".join(about["notes"]))
    if case != "view":
        by_ticks, true = measure(folder)
        np.testing.assert_allclose(by_ticks, true, atol=0.005)
        assert by_ticks[:1] == pytest.approx(LENGTHS_M[:1], abs=0.01) or case == "wheels lost"
    turns = open_recording(folder).turns
    assert turns is not None and (case != "counter restarts" or (turns.kind == 2).sum() == 1)


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
    assert len(held_out.observation) == about["held_out"] > 5
    both = [one for part in (kept, held_out) for one in (part.observation, part.turn_observation)]
    assert about["images_used"] == sum(len(one) for one in both if one is not None)
    labelled, _ = bring_in(log, tmp_path / "labelled", configure(pose={"use": "labels"}))
    labels = open_labels(labelled)
    assert not has_truth(labelled) and labels is not None and np.isfinite(labels.pose).all()
    few, _ = bring_in(log, tmp_path / "few", configure(pose=None, drive={"held_out": 0.01}))
    assert open_recording(few / "use").manifest.segments == 1, "errors could not be measured without"
    folder, about = bring_in(log, tmp_path / "again", configure(drive={"held_out": 0.3}))
    recording, truth = open_recording(folder), open_truth(folder)
    assert len(recording.test_observation) == len(truth.test_pose) == about["held_out"] > 5


def info(**fields: Any) -> Callable[[int, Note], Note]:
    return lambda _, note: set_fields(note, **fields)


REFUSED_LOGS: dict[str, tuple[Change, str]] = {
    "no calibration": (on(CAMERA_INFO, info(focal=0.0)), "/camera/camera_info: the camera is not calibrated .K is 0."),
    "model": (on(CAMERA_INFO, info(model="ocam")), "/camera/camera_info: model .ocam.: must be .equidistant"),
    "size": (on(CAMERA_INFO, info(height=81)), "/camera/camera_info: it is for 96 x 81 px, and images have 96 x 80"),
    "no info": (lose(CAMERA_INFO, 0.0, 99.0), "camera.info /camera/camera_info: .* has no such topic"),
    "no pose": (lose(TRUTH, 0.0, 99.0), "pose.topic /mocap/pose: .* has no such topic"),
}
"""Logs that are refused before a picture is unwrapped: the change, and what is said."""
LATE_REFUSALS: dict[str, tuple[Change, str]] = {
    "alike": (alike, r"images turn by \d+ deg in .* pairs, and the wheels never differ: do both joints move alike"),
    "damaged": (damage(*range(20, 334, 15)), r"/camera/image_raw at \d+\.\d+ s: .*picture is damaged; damaged"),
}
"""Logs whose drive or pictures are refused."""


def check_refused(how: Change, message: str, notes: list[Note], folder: Path) -> None:
    log = write_log(folder / "log", how(notes), "mcap_lz4")
    with pytest.raises(InputError, match=message) as caught:
        bring_in(log, folder)
    assert "\n" not in str(caught.value)
    assert [path.name for path in folder.iterdir()] == ["log.mcap"]


@pytest.mark.parametrize("case", REFUSED_LOGS)
def test_what_cannot_be_used_is_refused_in_one_line(case: str, notes: list[Note], tmp_path: Path) -> None:
    check_refused(*REFUSED_LOGS[case], notes, tmp_path)


@pytest.mark.parametrize(
    "case", [case if case == "alike" else pytest.param(case, marks=slow) for case in LATE_REFUSALS]
)
def test_what_contradicts_itself_is_refused_in_one_line(case: str, notes: list[Note], tmp_path: Path) -> None:
    check_refused(*LATE_REFUSALS[case], notes, tmp_path)


def test_a_place_that_cannot_take_a_recording_is_refused_before_the_log_is_read(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("mine")
    (tmp_path / "dangling").symlink_to("nothing")
    for out, why in (
        (tmp_path / "full", "is not empty"),
        (tmp_path / "full" / "mine" / "x", "cannot be made: .*mine is no folder"),
        (tmp_path / "dangling", "is a link"),
        (Path("."), "is the working folder|is not empty"),
        (Path("/proc"), "is a mount point"),
    ):
        with pytest.raises(InputError, match=f"({why}).*; a recording is written to a folder of its own"):
            import_log(tmp_path / "no log", configure(), out, ignore)
