"""A message of a log as it is stored, and the part of a log that holds it."""

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rosbags.typesys.store import Typestore

from sim.errors import InputError, WorkError, one_line, shorten

HEADER = "std_msgs/msg/Header"
FOREIGN = ("jsonschema", "protobuf", "flatbuffer", "ros1msg")
"""Encodings of MCAP that `rosbags` does not know; it raises them as a missing key."""


class Sample(NamedTuple):
    """A message of a log.

    Attributes:
        topic: Its topic.
        log_ns: When it was logged, by the recorder's clock [ns].
        stamp_ns: Its header's stamp, by the clock of who sent it [ns]; 0: it has none.
        data: The message as it is stored, for ``Part.decode``.
    """

    topic: str
    log_ns: int
    stamp_ns: int
    data: Any


class Part(Protocol):
    """A file of a log, or a folder of files with one index.

    Attributes:
        types: Type of each topic, such as ``sensor_msgs/msg/JointState``.
        counts: Number of messages of each topic where an index tells it.
    """

    types: dict[str, str]
    counts: dict[str, int]

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
        if isinstance(error, KeyError) and (encoding := why.strip("'")) in FOREIGN:
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
