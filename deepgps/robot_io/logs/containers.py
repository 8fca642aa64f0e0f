"""The containers of a log: ROS 1 bags, ROS 2 db3 and MCAP files, alone, split or in a folder, or plain files.

Messages are read one after the other, file by file, so a log of any size takes the same memory. Of a folder's
metadata.yaml only files that are compressed as a whole need anything.
"""

import re
import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import yaml
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import zstd
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from deepgps.robot_io.logs import plain_folder
from deepgps.robot_io.logs.sample import MENDING, Part, Sample, explained
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


class Topic(NamedTuple):
    """A topic of a file."""

    name: str  # Its name
    kind: str  # Its type
    text: str  # Definition of the type; empty: there is none
    idl: bool  # Whether the definition is in IDL
    count: int = 0  # Number of messages; 0: unknown


Walk = Callable[[Collection[str]], Iterator[tuple[str, int, bytes]]]
"""Topic, time of logging [ns] and data of the messages of some topics."""


class FilePart:
    """A file, or a folder of files that are compressed as a whole; ``faults`` says what is wrong, by topic."""

    def __init__(self, file: Path, topics: Sequence[Topic], walk: Walk) -> None:
        self.file, self._walk, self._ros1 = file, walk, file.suffix == ".bag"
        self.types, self.counts, self.faults = dict[str, str](), dict[str, int](), dict[str, str]()
        self._stores = dict[str, Typestore]()
        for one in topics:
            try:
                self._stores[one.name] = _define(one, self._ros1)
            except Exception:  # one topic's fault spoils no other
                self.faults[one.name] = f"the definition of {shorten(one.kind)} cannot be parsed"
                continue
            self.types[one.name] = one.kind
            self.counts[one.name] = self.counts.get(one.name, 0) + one.count

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        with explained(self.file):
            for topic, log_ns, stored in self._walk(topics):
                # a message of ROS 2 may be compressed by itself, as only metadata.yaml tells; CDR begins with 0
                data = zstd.decompress(stored) if bytes(stored[:4]) == ZSTD_MAGIC and not self._ros1 else stored
                yield Sample(topic, log_ns, self._read_stamp(topic, data), data)

    def decode(self, sample: Sample) -> Any:
        store = self._stores[sample.topic]
        take = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        with explained(self.file, f"{sample.topic}: "):
            return take(sample.data, self.types[sample.topic])

    def _read_stamp(self, topic: str, data: bytes) -> int:
        """The header's stamp [ns], without decoding; 0 if there is no header. In ROS 1 it comes after a counter, in CDR
        after four bytes of which the second tells the byte order."""
        fields = self._stores[topic].fielddefs.get(self.types[topic], ((), []))[1]
        if not fields or fields[0][1][1] != "std_msgs/msg/Header" or len(data) < 12:
            return 0
        seconds, nanoseconds = struct.unpack_from("<iI" if self._ros1 or data[1] & 1 else ">iI", data, 4)
        return seconds * 1_000_000_000 + nanoseconds


def _define(topic: Topic, ros1: bool) -> Typestore:
    """The types of a topic's messages; the standard ones if the file defines none."""
    if not topic.text:
        return _load_standard(ros1)
    store, types = get_typestore(Stores.EMPTY), {}
    if topic.idl:
        for text in topic.text.split("=" * 80 + "\n"):
            types |= get_types_from_idl(text.partition("\n")[2] if text.startswith("IDL: ") else text) if text else {}
    else:
        types = get_types_from_msg(topic.text, topic.kind)
    store.register(types)
    store.generate_msgdef(topic.kind, ros_version=1 if ros1 else 2)  # raises where a type is not defined
    return store


@cache
def _load_standard(ros1: bool) -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class Log:
    """An open log."""

    path: Path  # Its path
    notes: tuple[str, ...] = ()  # What the user should know of its files
    faults: Mapping[str, str] = field(default_factory=dict)  # Why a topic is left out
    parts: Sequence[Part] = field(default=(), repr=False)

    @property
    def types(self) -> dict[str, str]:
        """Type of each topic."""
        return {topic: kind for part in self.parts for topic, kind in part.types.items()}

    def read(self, topics: Collection[str]) -> Iterator[tuple[Sample, Part]]:
        """Messages of some topics, in the order of the files; the part decodes them."""
        for part in self.parts:
            if wanted := [topic for topic in topics if topic in part.types]:
                for sample in part.read(wanted):
                    yield sample, part

    def feed(self, takers: Mapping[str, Callable[[Sample, Part], None]], progress: Report, label: str = "") -> None:
        """Read some topics once, and give each message to what takes its topic."""
        label, total = label or "read log", sum(part.counts.get(topic, 0) for part in self.parts for topic in takers)
        progress(label, 0, total or 1)
        for count, (sample, part) in enumerate(self.read(takers), start=1):
            if count % STRIDE == 0 and count < total:
                progress(label, count, total)
            takers[sample.topic](sample, part)
        progress(label, total or 1, total or 1)

    def check_topic(self, topic: str, name: str, kinds: Collection[str]) -> str:
        """The type of a topic; raises InputError that names the setting unless it is one of ``kinds``."""
        kind = self.types.get(topic)
        short = ", ".join(one.rpartition("/")[2] for one in kinds)
        if topic in self.faults:
            raise InputError(f"{name} {topic}: {self.faults[topic]}")
        if kind is None:
            there = [other for other, its in self.types.items() if its in kinds]
            hint = f"; topics of type {short}: {', '.join(there)}" if there else f"; it has none of type {short}"
            raise InputError(f"{name} {topic}: {self.path} has no such topic{hint}")
        if kind not in kinds:
            raise InputError(f"{name} {topic}: its type is {kind}, and must be {short}")
        return kind


@contextmanager
def open_log(path: Path) -> Iterator[Log]:
    """Open a .bag, .mcap or .db3 file, a folder of them, or a folder with images and ``wheels.csv``.

    Raises InputError if it is no log, or is damaged in another way than an MCAP that ends early.
    """
    name = shorten(str(path), 300)
    if not path.exists():
        raise InputError(f"{name}: there is no such log")
    if plain_folder.is_plain(path):
        with explained(path):
            part = plain_folder.PlainFolder(path)
        yield Log(path, parts=[part])
        return
    if path.is_file() and path.suffix not in MENDING:
        hint = "; a killed recorder left this one: rosbag reindex" if path.suffix == ".active" else ""
        raise InputError(f"{name}: a log is a .bag, .mcap or .db3 file, or a folder{hint}")
    files, notes = ([path], []) if path.is_file() else _list_files(path)
    if not files:
        what = "neither .bag, .mcap or .db3 files (unpack .zstd by zstd -d) nor images and wheels.csv"
        raise InputError(f"{name} holds no log: {what}")
    with ExitStack() as stack:
        parts = [_open_file(file, stack, notes) for file in files]
        faults = {topic: why for part in parts for topic, why in part.faults.items()}
        notes += [f"{topic} is left out: {why}" for topic, why in faults.items()]
        yield Log(path, tuple(notes), faults, parts)


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
    listed = None
    with suppress(OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        about = yaml.safe_load((folder / METADATA).read_text())["rosbag2_bagfile_information"]
        listed = {PurePath(name).name for name in about["relative_file_paths"]}
    fits = listed is not None and listed >= {one.name for one in stored}
    return stored, [] if fits else [f"{METADATA} is missing or does not fit: the files are read without it"]


def _open_file(file: Path, stack: ExitStack, notes: list[str]) -> FilePart:
    """Open a file; of an MCAP that its index does not open, all whole chunks are read, with a note."""
    _check_file(file)
    with explained(file):
        try:
            reader = stack.enter_context((BagReader if file.suffix == ".bag" else Reader)(file))
        except Exception as error:
            if file.suffix != ".mcap":
                raise
            if not (topics := _list_topics(file)):
                raise InputError(f"{file}: {one_line(error)} It has no whole chunk with messages of ROS 2") from None
            notes.append(f"{file.name}: {shorten(one_line(error), 120)} It is read to its last whole chunk.")
            return FilePart(file, topics, lambda wanted: _walk(file, wanted))

    def walk(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        chosen = [one for one in reader.connections if one.topic in wanted]
        for one, log_ns, data in reader.messages(chosen):
            yield one.topic, log_ns, data

    idl = MessageDefinitionFormat.IDL
    return FilePart(
        file,
        [
            Topic(one.topic, one.msgtype, one.msgdef.data, one.msgdef.format == idl, one.msgcount)
            for one in reader.connections
            if getattr(one.ext, "serialization_format", "cdr") == "cdr"
        ],
        walk,
    )


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


def _walk(file: Path, wanted: Collection[str] | None) -> Iterator[Any]:
    """Messages of some topics in an MCAP up to its last whole chunk; None: its channels and schemas."""
    names = dict[int, str]()
    with file.open("rb") as stream, suppress(Exception):  # whatever a damaged record makes of it
        for record in StreamReader(stream, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES).records:
            if isinstance(record, Channel):
                names[record.id] = record.topic if record.message_encoding == "cdr" else ""
            if wanted is None and isinstance(record, Channel | Schema):
                yield record
            elif wanted and isinstance(record, Message) and names.get(record.channel_id) in wanted:
                yield names[record.channel_id], record.log_time, record.data


def _list_topics(file: Path) -> list[Topic]:
    """The topics of an MCAP, without its index."""
    schemas, topics = dict[int, Schema](), dict[str, Topic]()
    for one in _walk(file, None):
        if isinstance(one, Schema):
            schemas[one.id] = one
        elif one.message_encoding == "cdr" and one.schema_id in schemas:
            schema = schemas[one.schema_id]
            idl = schema.encoding in {"ros2idl", "omgidl"}
            topics[one.topic] = Topic(one.topic, schema.name, schema.data.decode(), idl)
    return list(topics.values())
