"""Containers: what is whole is read, a fault is named in one line with what mends it, and one spoils no other topic."""

import shutil
from pathlib import Path

import pytest
import yaml
from mcap.writer import Writer

from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.sample import explained
from sim.errors import InputError
from tests.helpers.robot_log import JOINTS, START_NS, Note, make_notes, write_log


@pytest.fixture(scope="module")
def notes() -> list[Note]:
    """The messages of the first seconds but for pictures."""
    return [one for one in make_notes("image/jpeg") if one.topic == JOINTS or one.log_ns < START_NS + 10**9]


def read_all(log: Path) -> tuple[list[int], tuple[str, ...]]:
    """Times of logging of all messages, and what is noted; each is decoded."""
    with open_log(log) as opened:
        samples = list(opened.read(list(opened.types)))
        assert all(sample.decode() is not None for sample in samples)
        return sorted(sample.log_ns for sample in samples), (*opened.notes,)


def check_refused(log: Path, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_all(log)
    assert "\n" not in str(caught.value)


def test_a_database_needs_no_metadata(notes: list[Note], tmp_path: Path) -> None:
    for form in ("db3", "db3_zstd"):  # compressed one by one
        folder = write_log(tmp_path / form, notes, form)
        whole, said = read_all(folder)
        assert len(whole) == len(notes) and said == ()
        about = folder / "metadata.yaml"
        fits = about.read_text()
        second = fits.replace(f"- {form}.db3", f"- {form}.db3\n  - bag/other.db3")
        for text in ("", fits[:200], "\0" * 99, fits.replace(f"{form}.db3", "other.db3"), second, None):
            about.unlink() if text is None else about.write_text(text)
            found, said = read_all(folder)
            what = "lists other.db3, which is not there" if "other" in str(text) else "is missing or does not fit"
            assert found == whole and said == (f"metadata.yaml {what}: the files are read without it",)
        about.write_text(fits + 10**6 * "#")
        assert read_all(folder) == (whole, ())
        values = yaml.safe_load(fits)
        values["rosbag2_bagfile_information"]["version"] = 10
        about.write_text(yaml.safe_dump(values))
        assert read_all(folder) == (whole, ())


def test_a_database_that_is_compressed_as_a_whole_is_read(notes: list[Note], tmp_path: Path) -> None:
    folder = write_log(tmp_path / "log", notes, "db3_file_zstd")
    assert {file.suffix for file in folder.iterdir()} == {".zstd", ".yaml"}
    assert read_all(folder) == (sorted(note.log_ns for note in notes), ())


def test_a_database_that_would_be_read_wrongly_is_refused(notes: list[Note], tmp_path: Path) -> None:
    (file,) = write_log(tmp_path / "log", notes, "db3").glob("*.db3")
    for name in ("a#1", "a?x", "a%20y"):
        check_refused(Path(shutil.copy(file, tmp_path / f"{name}.db3")), "must be without #, . and %")
    wal = file.with_name(f"{file.name}-wal")
    wal.write_bytes(b"x")
    check_refused(file, r"its last messages are in log\.db3-wal; sqlite3 log\.db3 'PRAGMA wal_checkpoint'")
    wal.write_bytes(b"")
    file.write_bytes(file.read_bytes()[:-5000])
    check_refused(file, r"log\.db3 cannot be read as a log: .*may be mended by sqlite3 with \.recover")


def test_an_mcap_is_read_to_its_last_whole_chunk_and_a_bag_is_not(notes: list[Note], tmp_path: Path) -> None:
    many = [one for one in make_notes("image/jpeg") if one.log_ns < START_NS + 10 * 10**9]
    log = write_log(tmp_path / "log", many, "mcap_lz4")
    whole, size = log.read_bytes(), log.stat().st_size
    for data in (whole[: size * 7 // 10], whole[: size * 7 // 10] + b"\0" * 50_000, whole[:-20]):
        log.write_bytes(data)
        found, (said,) = read_all(log)
        times = [one.log_ns for one in many]
        assert found == times[: len(found)] and len(found) > 0.3 * len(times)
        assert said.startswith("log.mcap: ") and said.endswith("; it is read to its last whole chunk")
    log.write_bytes(whole[:3000])
    check_refused(log, r"log\.mcap: .*; it has no whole chunk with messages of ROS 2")
    bag = write_log(tmp_path / "log", notes, "bag")
    bag.write_bytes(bag.read_bytes()[:-20])
    check_refused(bag, r"log\.bag cannot be read as a log: .*may be mended by rosbag reindex")


def test_split_files_in_a_folder_are_one_log(notes: list[Note], tmp_path: Path) -> None:
    for number in range(11):
        write_log(tmp_path / f"drive_{number}", notes[number::11], "mcap_lz4")
    (tmp_path / "drive_11.mcap").touch()
    (tmp_path / "._drive_0.mcap").write_bytes(b"\0\5\x16\7 of macOS")
    assert read_all(tmp_path)[0] == sorted(one.log_ns for one in notes)
    with open_log(tmp_path) as log:
        found = [one.log_ns for one in log.read(list(log.types))]
    assert found == [one.log_ns for number in range(11) for one in notes[number::11]], "2 comes before 10"


def test_a_bad_definition_spoils_nothing(tmp_path: Path) -> None:
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        for topic, kind, text in (
            ("/service", "a_msgs/srv/Odd_Event", "int64 a\n---\nint64 b"),
            ("/lacking", "std_msgs/msg/Int32", "a_msgs/Part part"),
            ("/standard", "std_msgs/msg/Int32", ""),
        ):
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channel, 1, b"\0\1\0\0\7\0\0\0", 1)
        writer.finish()
    with open_log(tmp_path / "log.mcap") as log:
        assert len(list(log.read(list(log.types)))) == 3
        assert [sample.decode().data for sample in log.read(["/lacking", "/standard"])] == [7, 7]
        with pytest.raises(InputError, match=r"wheels\.topic /service: its type is a_msgs/srv/Odd_Event, and must be"):
            log.check_topic("/service", "wheels.topic", ["sensor_msgs/msg/JointState"])


def test_files_that_are_something_else_are_named(tmp_path: Path) -> None:
    for data, message in (
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", r"is a Git LFS pointer \(git lfs pull\)"),
        (b"\n<!DOCTYPE html>\n<html>", "is a web page in place of the file"),
        (b"no log at all, but long enough to be one of some kind", "cannot be read as a log|it has no whole chunk"),
        (b"SQLite format 3\0" + b"\1" * 200, "cannot be read as a log|it has no whole chunk"),
    ):
        for suffix in (".bag", ".mcap", ".db3"):
            file = tmp_path / f"a{suffix}"
            file.write_bytes(data)
            check_refused(file, rf"a\{suffix}.*({message})")
    for name, message in (("a.txt", "a log is a .bag, .mcap or .db3"), ("a.bag.active", "rosbag reindex")):
        (tmp_path / name).write_bytes(b"x")
        check_refused(tmp_path / name, message)
    check_refused(tmp_path / "none.mcap", "there is no such log")
    (tmp_path / "empty").mkdir()
    check_refused(tmp_path / "empty", r"holds no log: neither \.bag, \.mcap or \.db3 files nor images")
    message = r"/log\.mcap cannot be read as a log: /a: jsonschema"
    with pytest.raises(InputError, match=message), explained(tmp_path / "log.mcap", "/a: "):
        raise LookupError("jsonschema")
