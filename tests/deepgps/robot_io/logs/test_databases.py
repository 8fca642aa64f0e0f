"""Databases of ROS 2 whose recorder was killed, or whose paths are no plain URI, hold all their messages."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from deepgps.robot_io.logs.containers import open_log
from sim.errors import InputError
from tests.helpers.robot_log import JOINTS, Note, make_notes, write_log

SPECIAL = ("a#1", "a?x", "a%20y", "a b")
LATE_MESSAGES = 500
"""Messages that are in the -wal file alone."""


@pytest.fixture(scope="module")
def notes() -> list[Note]:
    return make_notes("image/jpeg")


def check_complete(log: Path, notes: list[Note]) -> None:
    """All messages are read, and no file of the user's is changed, added or removed."""
    before = list_contents(log)
    with open_log(log) as opened:
        times = [sample.log_ns for sample, _ in opened.read(list(opened.types))]
        assert opened.notes == ()
    assert sorted(times) == sorted(note.log_ns for note in notes)
    assert list_contents(log) == before


def list_contents(log: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (log if log.is_dir() else log.parent).iterdir() if path.is_file()}


def rename(log: Path, name: str) -> Path:
    """Name a folder and the files in it as if they had been recorded under this name."""
    for path in list(log.iterdir()):
        if path.name == "metadata.yaml":
            path.write_text(path.read_text().replace(f"{log.name}.db3", f"{name}.db3"))
        else:
            path.rename(log / f"{name}.db3")
    return log.rename(log.with_name(name))


@pytest.mark.parametrize(
    "form", ["db3", *(pytest.param(form, marks=pytest.mark.slow) for form in ("db3_v5", "db3_zstd"))]
)
def test_a_path_may_hold_what_is_special_in_a_uri(form: str, notes: list[Note], tmp_path: Path) -> None:
    log = write_log(tmp_path / "log", notes, form)
    for name in SPECIAL:
        log = rename(log, name)
        check_complete(log, notes)
        check_complete(log / f"{name}.db3", notes)


def kill_recorder(log: Path, copy: Path) -> Path:
    """A copy of a log of which the last messages are in the -wal file beside its database."""
    (file,) = log.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        database.executescript("PRAGMA journal_mode=WAL; PRAGMA wal_autocheckpoint=0;")
        last = f"FROM messages ORDER BY id DESC LIMIT {LATE_MESSAGES}"
        rows = database.execute(f"SELECT topic_id, timestamp, data {last}").fetchall()
        database.execute(f"DELETE FROM messages WHERE id IN (SELECT id {last})")
        database.commit()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows[::-1])
        database.commit()
        copy.mkdir()
        for path in (file, file.with_name(f"{file.name}-wal"), log / "metadata.yaml"):
            (copy / path.name).write_bytes(path.read_bytes())
    return copy


def test_messages_that_a_killed_recorder_left_aside_are_read(notes: list[Note], tmp_path: Path) -> None:
    log = kill_recorder(write_log(tmp_path / "log", notes, "db3_v5"), tmp_path / "killed#1")
    for _ in range(2):
        check_complete(log, notes)
        check_complete(log / "log.db3", notes)
        (log / "metadata.yaml").unlink(missing_ok=True)
    with (log / "log.db3").open("r+b") as stream:
        stream.truncate(100_000)
    with pytest.raises(InputError, match=r"log\.db3-wal does not fit log\.db3 .*; move it away to read the rest"):
        check_complete(log, notes)


@pytest.mark.parametrize("cut", [False, True])
def test_messages_that_are_compressed_one_by_one_are_read_without_metadata(
    cut: bool, notes: list[Note], tmp_path: Path
) -> None:
    log = write_log(tmp_path / "log", notes, "db3_zstd")
    (log / "metadata.yaml").unlink()
    if cut:
        (file,) = log.glob("*.db3")
        file.write_bytes(file.read_bytes()[:-5000])
    with open_log(log) as opened:
        stamps = [sample.stamp_ns for sample, _ in opened.read([JOINTS])]
        assert len(stamps) > (0.5 if cut else 0.999) * sum(note.topic == JOINTS for note in notes)
        assert all(stamps)
