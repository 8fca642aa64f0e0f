"""The containers of a log: ROS 1 bags, ROS 2 db3 and MCAP files, alone, split or in a folder, or plain files.

Messages are read one after the other, file by file, so a log of any size takes the same memory. They are decoded by the
standard types, which are alike in all versions of ROS, so definitions in a file can spoil nothing.
"""

import re
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import zstd
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from deepgps.config.plain_yaml import MAX_FILE_BYTES
from deepgps.robot_io.logs import plain_folder
from deepgps.robot_io.logs.sample import MENDING, Heard, Part, Sample, explained
from deepgps.terminal.progress import Report
from sim.errors import InputError, one_line, shorten

METADATA, ZSTD, ZSTD_MAGIC = "metadata.yaml", ".zstd", b"\x28\xb5\x2f\xfd"
OTHER_CONTENTS = {
    b"version https://git-lfs": "a Git LFS pointer (git lfs pull)",
    b"<": "a web page in place of the file",
}
"""What other files begin with, and what they are."""
MAX_RECORD_BYTES = 2**30
STRIDE = 1000  # Messages between two reports of progress
Walk = Callable[[Collection[str]], Iterator[tuple[str, int, bytes]]]
"""Topic, time of logging [ns] and data of the messages of some topics."""


@dataclass(frozen=True)
class Log:
    """An open log."""

    path: Path
    notes: Sequence[str] = ()  # What the user should know of its files
    parts: Sequence[Part] = field(default=(), repr=False)

    @property
    def types(self) -> dict[str, str]:
        """Type of each topic."""
        return {topic: kind for part in self.parts for topic, kind in part.types.items()}

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        """Messages of some topics, in the order of the files."""
        for part in self.parts:
            if wanted := [topic for topic in topics if topic in part.types]:
                yield from part.read(wanted)

    def feed(self, heard: Iterable[Heard], progress: Report, label: str = "read log") -> None:
        """Read some topics once, and give each message to what takes its topic."""
        takers = {one.topic: one.take for one in heard}
        total = sum(part.counts.get(topic, 0) for part in self.parts for topic in takers)
        progress(label, 0, total or 1)
        for count, sample in enumerate(self.read(takers), start=1):
            if count % STRIDE == 0 and count < total:
                progress(label, count, total)
            takers[sample.topic](sample)
        progress(label, total or 1, total or 1)

    def check_topic(self, topic: str, name: str, kinds: Collection[str]) -> str:
        """The type of a topic; raises InputError that names the setting unless it is one of ``kinds``."""
        kind, short = self.types.get(topic), ", ".join(one.rpartition("/")[2] for one in kinds)
        if kind is None:
            there = [other for other, its in self.types.items() if its in kinds]
            hint = f"; topics of type {short}: {', '.join(there)}" if there else f"; it has none of type {short}"
            raise InputError(f"{name} {topic}: {self.path} has no such topic{hint}")
        if kind not in kinds:
            raise InputError(f"{name} {topic}: its type is {kind}, and must be {short}")
        return kind


@contextmanager
def open_log(path: Path) -> Iterator[Log]:
    """Open a .bag, .mcap or .db3 file, a folder of them, or a folder with images and ``wheels.csv``; raises InputError
    if it is no log, or is damaged in another way than an MCAP that ends early."""
    name = shorten(str(path), 300)
    if not path.exists():
        raise InputError(f"{name}: there is no such log")
    if (path / plain_folder.WHEELS).is_file() and (path / plain_folder.IMAGES).is_dir():
        with explained(path):
            part = plain_folder.open_folder(path)
        yield Log(path, parts=[part])
        return
    if path.is_file() and path.suffix not in MENDING:
        hint = "; a killed recorder left this one: rosbag reindex" if path.suffix == ".active" else ""
        raise InputError(f"{name}: a log is a .bag, .mcap or .db3 file, or a folder{hint}")
    files, notes = ([path], []) if path.is_file() else _list_files(path)
    if not files:
        what = "neither .bag, .mcap or .db3 files nor images and wheels.csv"
        raise InputError(f"{name} holds no log: {what}")
    with ExitStack() as stack:
        yield Log(path, notes, [_open_file(file, stack, notes) for file in files])


def _list_files(folder: Path) -> tuple[list[Path], list[str]]:
    """The files of a log in the order in which they were written, and notes; the folder itself, if files are compressed
    as a whole."""
    files = [one for one in folder.iterdir() if one.is_file() and not one.name.startswith("._")]  # which macOS adds
    stored = [one for one in files if one.suffix in MENDING and one.stat().st_size]
    stored.sort(key=lambda one: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", one.name)])
    if not stored and any(one.suffix == ZSTD for one in files) and (folder / METADATA).is_file():
        return [folder], []
    if all(one.suffix == ".bag" for one in stored):
        return stored, []
    about = b""
    with suppress(OSError), (folder / METADATA).open("rb") as stream:
        about = stream.read(MAX_FILE_BYTES)
    lines = (line.strip(" '\"") for line in about.decode(errors="replace").splitlines())
    listed = {re.split("/|path: |- ", line)[-1].strip("'\"") for line in lines if line.endswith((".db3", ".mcap"))}
    if listed == (names := {one.name for one in stored}):
        return stored, []
    lost = ", ".join(sorted(listed - names))
    what = f"lists {lost}, which is not there" if lost else "is missing or does not fit"
    return stored, [f"{METADATA} {what}: the files are read without it"]


def _open_file(file: Path, stack: ExitStack, notes: list[str]) -> Part:
    """Open a file; of an MCAP that its index does not open, all whole chunks are read, with a note."""
    _check_file(file)
    with explained(file):
        try:
            reader = stack.enter_context((BagReader if file.suffix == ".bag" else Reader)(file))
        except Exception as error:
            if file.suffix != ".mcap":
                raise
            part, why = _open_cut(file), shorten(one_line(error), 120).rstrip(".")
            if not part.types:
                raise InputError(f"{file}: {why}; it has no whole chunk with messages of ROS 2") from None
            notes.append(f"{file.name}: {why}; it is read to its last whole chunk")
            return part

    def walk(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        chosen = [one for one in known if one.topic in wanted]
        return ((one.topic, log_ns, data) for one, log_ns, data in reader.messages(chosen))

    known = [one for one in reader.connections if getattr(one.ext, "serialization_format", "cdr") == "cdr"]
    counts = Counter[str]()
    for one in known:
        counts[one.topic] += one.msgcount
    return _make_part(file, {one.topic: one.msgtype for one in known}, counts, walk)


def _check_file(file: Path) -> None:
    """Raise InputError if a file is something else, or is one of those that the library reads wrongly."""
    name = shorten(str(file), 300)
    if file.is_file():
        with file.open("rb") as stream:
            head = stream.read(64).lstrip()
        if kind := next((what for begin, what in OTHER_CONTENTS.items() if head.startswith(begin)), None):
            raise InputError(f"{name} is {kind}")
    wal = file.with_name(f"{file.name}-wal")
    if file.suffix == ".db3" and wal.is_file() and wal.stat().st_size:  # whose messages would be missed
        raise InputError(f"{name}: its last messages are in {wal.name}; sqlite3 {file.name} 'PRAGMA wal_checkpoint'")
    if file.suffix in {".db3", ""} and re.search(r"[#?%]", str(file.absolute())):
        raise InputError(f"{name}: the path of a database must be without #, ? and %")


def _open_cut(file: Path) -> Part:
    """An MCAP up to its last whole chunk, without its index."""
    kinds, names, types = dict[int, str](), dict[int, str](), dict[str, str]()
    for record in _read_records(file):
        if isinstance(record, Schema):
            kinds[record.id] = record.name
        elif isinstance(record, Channel) and record.message_encoding == "cdr" and record.schema_id in kinds:
            names[record.id], types[record.topic] = record.topic, kinds[record.schema_id]

    def walk(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        for record in _read_records(file):
            if isinstance(record, Message) and names.get(record.channel_id) in wanted:
                yield names[record.channel_id], record.log_time, record.data

    return _make_part(file, types, {}, walk)


def _read_records(file: Path) -> Iterator[Any]:
    with file.open("rb") as stream, suppress(Exception):  # whatever a damaged record makes of it
        yield from StreamReader(stream, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records


def _make_part(file: Path, types: Mapping[str, str], counts: Mapping[str, int], walk: Walk) -> Part:
    """The part of a log that a file is, or a folder of files that are compressed as a whole."""
    ros1 = file.suffix == ".bag"
    store = _load_standard(ros1)
    stamped = {topic for topic, kind in types.items() if _has_header(store, kind)}

    def decode(topic: str, data: bytes) -> Any:
        with explained(file, f"{topic}: "):
            return (store.deserialize_ros1 if ros1 else store.deserialize_cdr)(data, types[topic])

    def read(topics: Collection[str]) -> Iterator[Sample]:
        with explained(file):
            for topic, log_ns, stored in walk(topics):
                # a message of ROS 2 may be compressed by itself, as only metadata.yaml tells; CDR begins with 0
                data = zstd.decompress(stored) if bytes(stored[:4]) == ZSTD_MAGIC and not ros1 else stored
                stamp_ns = _read_stamp(data, ros1) if topic in stamped else 0
                yield Sample(topic, log_ns, stamp_ns, partial(decode, topic, data))

    return Part(types, counts, read)


@cache
def _load_standard(ros1: bool) -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def _has_header(store: Typestore, kind: str) -> bool:
    fields = store.fielddefs.get(kind, ((), []))[1]
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"


def _read_stamp(data: bytes, ros1: bool) -> int:
    """The header's stamp [ns], without decoding; 0 if there is none. In ROS 1 it comes after a counter, in CDR after
    four bytes of which the second tells the byte order."""
    if len(data) < 12:
        return 0
    seconds, nanoseconds = struct.unpack_from("<iI" if ros1 or data[1] & 1 else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds
