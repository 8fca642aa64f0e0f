"""Messages of a log as they are stored, also in files that were cut off, as by a flat battery."""

import sqlite3
import struct
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1.reader import Header, RecordType, decompressors, normalize, normalize_msgtype
from rosbags.rosbag2.storage_mcap import decompress, zstd
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sim.errors import InputError, WorkError, one_line, shorten

HEADER = "std_msgs/msg/Header"
FOREIGN_ENCODINGS = ("jsonschema", "protobuf", "flatbuffer", "ros1msg")
"""Encodings of MCAP that `rosbags` does not know; it raises them as a missing key."""


class Sample(NamedTuple):
    """A message of a log."""

    topic: str  # Its topic
    log_ns: int  # When it was logged, by the recorder's clock [ns]
    stamp_ns: int  # Its header's stamp, by the clock of who sent it [ns]; 0: it has none
    data: Any  # The message as it is stored, for ``Part.decode``


class Part(Protocol):
    """A file of a log, or a folder of files with one index."""

    types: dict[str, str]  # Type of each topic, such as ``sensor_msgs/msg/JointState``
    counts: dict[str, int]  # Number of messages of each topic where an index tells it

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        """The messages of some topics."""
        ...

    def decode(self, sample: Sample) -> Any:
        """The message with its fields; raises InputError if it is damaged."""
        ...


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Raise every exception of the libraries that read logs as an InputError of one line."""
    try:
        yield
    except (InputError, WorkError, MemoryError, OSError):
        raise
    except Exception as error:
        why = one_line(error) or type(error).__name__
        if isinstance(error, KeyError) and (encoding := why.strip("'")) in FOREIGN_ENCODINGS:
            why = f"it has a channel in {encoding}, and only messages of ROS 2 are read; write the log without it"
        raise InputError(f"{shorten(str(path), 300)} cannot be read as a log: {why}") from None


def read_stamp(store: Typestore, kind: str, data: bytes, ros1: bool = False) -> int:
    """The header's stamp of a stored message [ns], without decoding it; 0 if its type has no header.

    Args:
        store: Definitions of types.
        kind: The message's type.
        data: The message; in CDR after four bytes of which the second tells the byte order, in ROS 1 after a counter.
        ros1: Whether it is a message of ROS 1.
    """
    fields = store.fielddefs.get(kind, ((), []))[1]
    if not fields or fields[0][1][1] != HEADER or len(data) < 12:
        return 0
    little = ros1 or data[1] & 1
    seconds, nanoseconds = struct.unpack_from("<iI" if little else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds


MCAP_MAGIC = b"\x89MCAP0\r\n"
BAG_MAGIC = b"#ROSBAG V2.0\n"
MCAP_SCHEMA, MCAP_CHANNEL, MCAP_MESSAGE, MCAP_CHUNK = 3, 4, 5, 6
MAX_RECORD_BYTES = 2**31
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Connection(NamedTuple):
    """A topic of a file: its name, its type, and the definition of the type, which may be empty."""

    topic: str
    kind: str
    definition: str
    form: MessageDefinitionFormat = MessageDefinitionFormat.MSG


Found = Iterator[Connection | tuple[str, int, bytes]]
"""Topics, and messages as topic, log time [ns] and data, in the order of the file."""


def is_truncated(file: Path) -> bool:
    """Whether a .mcap, .bag or .db3 file was cut off before its end."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        head = stream.read(128)
        if file.suffix == ".mcap":
            stream.seek(max(size - len(MCAP_MAGIC), 0))
            return head.startswith(MCAP_MAGIC) and (size < 2 * len(MCAP_MAGIC) or stream.read() != MCAP_MAGIC)
        if file.suffix == ".bag":
            return head.startswith(BAG_MAGIC) and _find_index(file) not in range(1, size)
        if len(head) < 100 or not head.startswith(b"SQLite format 3\0"):
            return False
        page, pages = struct.unpack_from(">H", head, 16)[0], struct.unpack_from(">I", head, 28)[0]
        return size < (65536 if page == 1 else page) * pages


class Salvaged:
    """A part of a log that was cut off.

    Attributes:
        types: Type of each topic.
    """

    def __init__(self, file: Path, walk: Callable[[Path], Found], default: Stores) -> None:
        self.file, self._walk, self._ros1 = file, walk, default == Stores.ROS1_NOETIC
        found = [one for one in walk(file) if isinstance(one, Connection)]
        self.types = {one.topic: one.kind for one in found}
        self.counts: dict[str, int] = {}
        self._store = _define(found, default)

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        for one in self._walk(self.file):
            if not isinstance(one, Connection) and one[0] in topics:
                topic, log_ns, stored = one
                data = stored if self._ros1 else unpack(stored)
                yield Sample(topic, log_ns, read_stamp(self._store, self.types[topic], data, self._ros1), data)

    def decode(self, sample: Sample) -> Any:
        take = self._store.deserialize_ros1 if self._ros1 else self._store.deserialize_cdr
        with explained(self.file):
            return take(sample.data, self.types[sample.topic])


def unpack(data: bytes) -> bytes:
    """A message of ROS 2, which may be compressed by itself, as only metadata.yaml tells; CDR begins with 0."""
    return zstd.decompress(data) if bytes(data[:4]) == ZSTD_MAGIC else data


def salvage(file: Path) -> Salvaged:
    """Open a file that was cut off."""
    walk = {".mcap": walk_mcap, ".bag": walk_bag, ".db3": walk_database}[file.suffix]
    return Salvaged(file, walk, Stores.ROS1_NOETIC if file.suffix == ".bag" else Stores.ROS2_HUMBLE)


def walk_mcap(file: Path) -> Found:
    """Topics and messages of an MCAP file up to its last complete record."""
    kinds, channels = dict[int, tuple[str, str, str]](), dict[int, str]()

    def read_record(code: int, body: bytes) -> Found:
        if code == MCAP_SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            name, form, text, _ = _read_texts(body[2:], 3)
            kinds[number] = name, form, text
        elif code == MCAP_CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            channels[number], *_ = _read_texts(body[4:], 1)
            kind, form, text = kinds.get(schema, ("", "", ""))
            idl = form in {"ros2idl", "omgidl"}
            form_of = MessageDefinitionFormat.IDL if idl else MessageDefinitionFormat.MSG
            yield Connection(channels[number], kind, text, form_of)
        elif code == MCAP_MESSAGE:
            number, _, log_ns, _ = struct.unpack_from("<HIQQ", body)
            if number in channels:
                yield channels[number], log_ns, body[22:]
        elif code == MCAP_CHUNK:
            size, crc = struct.unpack_from("<QI", body, 16)
            compression, rest = _read_texts(body[28:], 1)
            yield from read_all(decompress(rest[8 : 8 + struct.unpack_from("<Q", rest)[0]], compression, size, crc))

    def read_all(block: bytes) -> Found:
        at = 0
        while at + 9 <= len(block):
            code, size = struct.unpack_from("<BQ", block, at)
            yield from read_record(code, block[at + 9 : at + 9 + size])
            at += 9 + size

    with file.open("rb") as stream:
        stream.seek(len(MCAP_MAGIC))
        while len(head := stream.read(9)) == 9:
            code, size = struct.unpack("<BQ", head)
            if size > MAX_RECORD_BYTES or len(body := stream.read(size)) < size:
                return
            yield from read_record(code, body)


def walk_bag(file: Path) -> Found:
    """Topics and messages of a ROS 1 bag up to its last complete record."""
    topics = dict[int, str]()

    def read_all(stream: IO[bytes]) -> Found:
        while (record := _read_bag_record(stream)) is not None:
            header, data = record
            code = header.get_uint8("op")
            if code == RecordType.CONNECTION:
                inner = _as_header(data)
                number, topic = header.get_uint32("conn"), normalize(header.get_string("topic"))
                if number not in topics:
                    topics[number] = topic
                    kind = normalize_msgtype(inner.get_string("type"))
                    yield Connection(topic, kind, inner.get_string("message_definition"))
            elif code == RecordType.MSGDATA and header.get_uint32("conn") in topics:
                yield topics[header.get_uint32("conn")], header.get_time("time"), data
            elif code == RecordType.CHUNK:
                yield from read_all(_as_stream(decompressors[header.get_string("compression")](data)))

    with file.open("rb") as stream:
        stream.seek(len(BAG_MAGIC))
        yield from read_all(stream)


def walk_database(file: Path) -> Found:
    """Topics and messages of a ROS 2 database up to its last readable row."""
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        database.execute("PRAGMA writable_schema=ON")  # otherwise a file with fewer pages than its head says is refused
        try:
            topics = {
                number: (topic, kind) for number, topic, kind in database.execute("SELECT id,name,type FROM topics")
            }
        except sqlite3.DatabaseError as error:
            raise InputError(f"{file} is cut off so early that it names no topic ({error})") from None
        yield from (Connection(topic, kind, "") for topic, kind in topics.values())
        with suppress(sqlite3.DatabaseError):
            for number, log_ns, data in database.execute("SELECT topic_id,timestamp,data FROM messages ORDER BY id"):
                if number not in topics:  # of a page that was written in part
                    return
                yield topics[number][0], log_ns, data


def _find_index(file: Path) -> int:
    """Where a bag's index begins; 0: it has none."""
    with file.open("rb") as stream:
        stream.seek(len(BAG_MAGIC))
        record = _read_bag_record(stream)
    return record[0].get_uint64("index_pos") if record else 0


def _read_bag_record(stream: IO[bytes]) -> tuple[Header, bytes] | None:
    """The next record's header and data; None: there is no complete one."""
    parts = []
    for _ in range(2):
        size = stream.read(4)
        if len(size) < 4 or (length := struct.unpack("<I", size)[0]) > MAX_RECORD_BYTES:
            return None
        parts.append(stream.read(length))
        if len(parts[-1]) < length:
            return None
    return _as_header(parts[0]), parts[1]


def _as_header(data: bytes) -> Header:
    return Header.read(_as_stream(struct.pack("<I", len(data)) + data))  # pyright: ignore[reportArgumentType]


def _as_stream(data: bytes) -> IO[bytes]:
    return BytesIO(data)


def _read_texts(body: bytes, count: int) -> tuple[Any, ...]:
    """Texts that each follow their length, and what is left."""
    texts = []
    for _ in range(count):
        (size,) = struct.unpack_from("<I", body)
        texts.append(body[4 : 4 + size].decode())
        body = body[4 + size :]
    return *texts, body


def _define(found: list[Connection], default: Stores) -> Typestore:
    """The types of a file; the standard ones where it defines none."""
    types = {}
    for one in found:
        if one.definition and one.form == MessageDefinitionFormat.IDL:
            types |= get_types_from_idl(one.definition)
        elif one.definition:
            types |= get_types_from_msg(one.definition, one.kind)
    store = get_typestore(Stores.EMPTY if types else default)
    store.register(types)
    return store
