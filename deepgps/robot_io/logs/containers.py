"""The containers of a log: ROS 1 bags, ROS 2 db3 and MCAP files, alone, split, or in a folder with metadata.yaml.

It puts their paths into a URI as they are, where #, ? and % mean something else, and it opens them as files that never
change, without what a recorder that was killed has left in the file ``-wal`` beside. Such databases are read through
links of other names, and through copies into which the ``-wal`` file is merged. The user's files stay as they are.

Messages are read one after the other, so a log of any size takes the same memory. Of a file that was cut off, every
complete message is read. A log is read in parts: a folder with its metadata.yaml is one, otherwise each file is one.
"""

import re
import shutil
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from deepgps.robot_io.logs.plain_folder import PlainFolder, is_plain
from deepgps.robot_io.logs.stored import Part, Sample, explained, is_truncated, read_stamp, salvage, unpack
from deepgps.terminal.progress import Report
from sim.errors import InputError, shorten
from sim.files.atomic import check_space

SUFFIXES = (".bag", ".mcap", ".db3")
SPECIAL_CHARACTERS = re.compile(r"[#?%]")
METADATA = "metadata.yaml"
ZSTD = ".zstd"
STRIDE = 1000  # Messages between two reports of progress


def prepare_databases(path: Path, files: Sequence[Path], stack: ExitStack) -> tuple[Path, list[Path]]:
    """Paths of a log and of its storage files under which ``rosbags`` reads all that its databases hold.

    Args:
        path: The log, a file or a folder.
        files: Its storage files that are not compressed.
        stack: Removes links and copies when it is closed.

    Raises:
        InputError: A database and its ``-wal`` file are damaged.
        WorkError: There is no space for the copy.
    """
    stored = [path] if path.is_file() else [one for one in path.iterdir() if not {*SUFFIXES}.isdisjoint(one.suffixes)]
    databases = [one for one in stored if ".db3" in one.suffixes]
    if not any(_has_wal(one) or SPECIAL_CHARACTERS.search(str(one.absolute())) for one in databases):
        return path, list(files)
    place = Path(stack.enter_context(TemporaryDirectory(prefix="deepgps-log-")))
    for one in stored:
        if one in databases and _has_wal(one):
            _merge(one, place / _rename(one.name))
        else:
            (place / _rename(one.name)).symlink_to(one.absolute())
    if (path / METADATA).is_file():
        _copy_metadata(path / METADATA, place / METADATA)
    return place if path.is_dir() else place / _rename(path.name), [place / _rename(one.name) for one in files]


def _rename(name: str) -> str:
    """A name without characters that are special in a URI."""
    return SPECIAL_CHARACTERS.sub(lambda found: f"={ord(found[0])}=", name)


def _wal(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")


def _has_wal(file: Path) -> bool:
    """Whether messages are in the ``-wal`` file of a database."""
    return _wal(file).is_file() and _wal(file).stat().st_size > 0


def _merge(file: Path, copy: Path) -> None:
    """Copy a database with all messages, also those of its ``-wal`` file."""
    check_space(copy, file.stat().st_size + 2 * _wal(file).stat().st_size)
    shutil.copyfile(file, copy)
    shutil.copyfile(_wal(file), _wal(copy))
    try:
        with closing(sqlite3.connect(copy)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.execute("PRAGMA journal_mode=DELETE")
    except sqlite3.DatabaseError as error:
        raise InputError(f"{_wal(file)} does not fit {file.name} ({error}); move it away to read the rest") from None


def _copy_metadata(file: Path, copy: Path) -> None:
    """Copy the metadata of a log whose files have other names."""
    values = yaml.safe_load(file.read_text())
    about = values["rosbag2_bagfile_information"]
    about["relative_file_paths"] = [_rename(PurePath(name).name) for name in about["relative_file_paths"]]
    copy.write_text(yaml.safe_dump(values, sort_keys=False))


@dataclass(frozen=True)
class Log:
    """An open log."""

    path: Path  # Its path
    types: dict[str, str]  # Type of each topic
    notes: tuple[str, ...] = ()  # What the user should know of its files
    _parts: Sequence[Part] = field(default=(), repr=False)

    def read(self, topics: Collection[str]) -> Iterator[tuple[Sample, Part]]:
        """Messages of some topics, in the order of the files; the part decodes them."""
        for part in self._parts:
            wanted = [topic for topic in topics if topic in part.types]
            if wanted:
                with explained(self.path):
                    for sample in part.read(wanted):
                        yield sample, part

    def feed(self, takers: Mapping[str, Callable[[Sample, Part], None]], progress: Report) -> None:
        """Read some topics once, and give each message to what takes its topic."""
        for sample, part in self.show(takers, "read log", progress):
            takers[sample.topic](sample, part)

    def show(self, topics: Collection[str], label: str, progress: Report) -> Iterator[tuple[Sample, Part]]:
        """The same messages; what was read of the number in the files' indices is reported from time to time."""
        total = sum(part.counts.get(topic, 0) for part in self._parts for topic in topics)
        progress(label, 0, total or 1)
        for count, message in enumerate(self.read(topics), start=1):
            if count % STRIDE == 0 and count < total:
                progress(label, count, total)
            yield message
        progress(label, total or 1, total or 1)

    def check_topic(self, topic: str, name: str, kinds: Collection[str]) -> str:
        """The type of a topic; raises InputError that names the setting unless it is one of ``kinds``."""
        kind = self.types.get(topic)
        short = ", ".join(one.rpartition("/")[2] for one in kinds)
        if kind is None:
            there = [other for other, its in self.types.items() if its in kinds]
            hint = f"; topics of type {short}: {', '.join(there)}" if there else f"; it has none of type {short}"
            raise InputError(f"{name} {topic}: {self.path} has no such topic{hint}")
        if kind not in kinds:
            raise InputError(f"{name} {topic}: its type is {kind}, and must be {short}")
        return kind


@contextmanager
def open_log(path: Path) -> Iterator[Log]:
    """Open a log.

    Args:
        path: A .bag, .mcap or .db3 file, a folder of them, or a folder with images and ``wheels.csv``.

    Raises:
        InputError: It is no log, or it is damaged in another way than cut off.
    """
    if not path.exists():
        raise InputError(f"{shorten(str(path), 300)}: there is no such log")
    if is_plain(path):
        with explained(path):
            part = PlainFolder(path)
        yield Log(path, part.types, (), [part])
        return
    files = _list_files(path)
    with ExitStack() as stack:
        with explained(path):
            place, copies = prepare_databases(path, files, stack)
            cut = [is_truncated(copy) for copy in copies]
            if path.is_dir() and (path / METADATA).is_file() and not any(cut):
                parts: list[Part] = [_open_indexed(path, place, stack)]
            else:
                some = zip(files, copies, cut, strict=True)
                parts = [salvage(copy) if bad else _open_indexed(file, copy, stack) for file, copy, bad in some]
        notes = tuple(
            f"{file.name} is cut off: what is complete is read" for file, bad in zip(files, cut, strict=True) if bad
        )
        types = {topic: kind for part in parts for topic, kind in part.types.items()}
        yield Log(path, types, notes, parts)


def _list_files(path: Path) -> list[Path]:
    """Storage files of a log, in the order in which they were written."""
    if path.is_file():
        if path.suffix not in SUFFIXES:
            hint = "; a killed recorder left this one: copy it without .active" if path.suffix == ".active" else ""
            raise InputError(f"{shorten(str(path), 300)}: a log is a .bag, .mcap or .db3 file, or a folder{hint}")
        return [path]
    files = [file for file in path.iterdir() if file.suffix in SUFFIXES and _holds_something(file)]
    if not files and not (path / METADATA).is_file():
        zipped = any(file.suffix == ZSTD for file in path.iterdir())
        hint = f"; files compressed as {ZSTD} need their metadata.yaml" if zipped else ""
        raise InputError(
            f"{shorten(str(path), 300)} holds no log: neither .bag, .mcap or .db3 files nor images and wheels.csv{hint}"
        )
    return sorted(files, key=lambda file: [int(part) if part.isdigit() else part for part in _split(file.name)])


def _holds_something(file: Path) -> bool:
    """Whether a file of a folder is a part of its log: not what a killed recorder or macOS left beside it."""
    return file.is_file() and file.stat().st_size > 0 and not file.name.startswith("._")


def _split(name: str) -> list[str]:
    """A name in pieces of text and of digits, in turn: log_10 comes after log_9."""
    return re.split(r"(\d+)", name)


def _open_indexed(file: Path, copy: Path, stack: ExitStack) -> Part:
    """Open a file, or a folder of files with one index, under the path at which it can be read."""
    defaults = get_typestore(Stores.ROS2_HUMBLE)  # rosbag2 up to version 5 stores no definitions of types
    return IndexedPart(file, stack.enter_context(AnyReader([copy], default_typestore=defaults)))


class IndexedPart:
    """A part that ``rosbags`` reads by its index."""

    def __init__(self, file: Path, reader: AnyReader) -> None:
        self.file, self.reader = file, reader
        self.types = {one.topic: one.msgtype for one in reader.connections}
        self.counts: dict[str, int] = {}
        for one in reader.connections:
            self.counts[one.topic] = self.counts.get(one.topic, 0) + one.msgcount

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        chosen = [one for one in self.reader.connections if one.topic in topics]
        for connection, log_ns, stored in self.reader.messages(chosen) if chosen else ():
            data = unpack(stored) if self.reader.is2 else stored
            stamp_ns = read_stamp(self.reader.typestore, connection.msgtype, data, not self.reader.is2)
            yield Sample(connection.topic, log_ns, stamp_ns, data)

    def decode(self, sample: Sample) -> Any:
        with explained(self.file):
            return self.reader.deserialize(sample.data, self.types[sample.topic])
