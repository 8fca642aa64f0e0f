"""MCAP files of ROS 2 messages, written in order of their log times."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.writer import Writer

from sim.errors import InputError
from sim.files.atomic import check_overwrite, write_atomic
from sim.robot_log.messages import type_store

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "deepgps "
"""Beginning of the name of the writing program in the header of our files; a key of what they hold follows."""
HEAD = 256
"""Bytes at the beginning of a file that hold its header."""
EVERY = 2000
"""Messages between two reports of progress."""


@dataclass(frozen=True)
class Topic:
    """The messages of one topic.

    Attributes:
        name: Its name.
        logged: When each message was recorded (n,) int64 [ns since 1970].
        make: Makes a message by its number.
    """

    name: str
    logged: np.ndarray
    make: Callable[[int], Any]


def check_file(path: Path) -> None:
    """Raise InputError unless a log may be written to this path."""
    if path.suffix != ".mcap":
        raise InputError(f"{path}: the name of a log must end in .mcap")
    check_overwrite(path, _is_ours, HEAD)


def holds(path: Path, key: str) -> bool:
    """Whether a file is complete and was written with this key."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return _is_ours(head := file.read(HEAD)) and f"{LIBRARY}{key}".encode() in head


def write_mcap(path: Path, topics: Sequence[Topic], key: str, progress: Callable[[int, int], None]) -> None:
    """Write a file aside and rename it when it is complete.

    Args:
        path: The file.
        topics: Its topics; of messages that were recorded at the same time, those of an earlier topic come first.
        key: What ``holds`` recognises the file by.
        progress: Called with the messages written and their number.

    Raises:
        WorkError: The disk is full, or writing fails.
    """

    def write(part: Path) -> None:
        with part.open("wb") as file:
            _write(file, topics, key, progress)

    write_atomic(path, write)


def _write(file: IO[bytes], topics: Sequence[Topic], key: str, progress: Callable[[int, int], None]) -> None:
    writer, channels, store = Writer(file), _Channels(), type_store()
    writer.start(profile="ros2", library=f"{LIBRARY}{key}")
    logged = np.concatenate([topic.logged for topic in topics])
    owner = [one for one in topics for _ in one.logged]
    number = np.concatenate([np.arange(len(topic.logged)) for topic in topics])
    for done, row in enumerate(np.argsort(logged, kind="stable").tolist()):
        if done % EVERY == 0:
            progress(done, len(logged))
        one = owner[row]
        message, ns = one.make(int(number[row])), int(logged[row])
        data = bytes(store.serialize_cdr(message, message.__msgtype__))
        writer.add_message(channels.find(writer, one.name, message.__msgtype__), ns, data, ns, int(number[row]))
    writer.finish()
    progress(len(logged), len(logged))


class _Channels:
    """Numbers of the topics in a file, which are registered with their types when they are first used."""

    def __init__(self) -> None:
        self._types, self._topics = dict[str, int](), dict[str, int]()

    def find(self, writer: Writer, topic: str, kind: str) -> int:
        if kind not in self._types:
            text, _ = type_store().generate_msgdef(kind, ros_version=2)
            self._types[kind] = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
        if topic not in self._topics:
            number = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=self._types[kind])
            self._topics[topic] = number
        return self._topics[topic]


def _is_ours(head: bytes) -> bool:
    return head.startswith(MAGIC) and LIBRARY.encode() in head
