"""A message of a log, a part of a log, and errors of those who read them in one line."""

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from sim.errors import InputError, WorkError, one_line, shorten

MENDING = {".bag": "rosbag reindex", ".db3": "sqlite3 with .recover, then ros2 bag reindex", ".mcap": "mcap recover"}
"""What mends a damaged file, by its suffix."""


class Sample(NamedTuple):
    """A message of a log."""

    topic: str  # Its topic
    log_ns: int  # When it was logged, by the recorder's clock [ns]
    stamp_ns: int  # Its header's stamp, by the clock of who sent it [ns]; 0: it has none
    decode: Callable[[], Any]  # Gives the message with its fields; raises InputError if it is damaged


class Part(NamedTuple):
    """A part of a log."""

    types: Mapping[str, str]  # Type of each topic, such as ``sensor_msgs/msg/JointState``
    counts: Mapping[str, int]  # Number of messages of each topic where an index tells it
    read: Callable[[Collection[str]], Iterator[Sample]]  # Gives the messages of some topics


class Heard:
    """The messages of a topic, in the order of the files: their times, and numbers that they hold."""

    LEFT_OUT = ""  # Why messages are left out

    def __init__(self, topic: str) -> None:
        self.topic, self.without = topic, 0  # How many messages hold no such numbers, and are left out
        self.log_ns, self.stamp_ns = array("q"), array("q")  # When each was logged, and its stamp [ns]; 0: none
        self._values = array("d")

    def take(self, sample: Sample) -> None:
        """Note the times of a message, and its numbers if it holds any."""
        if (values := self.read(sample)) is None:
            self.without += 1
            return
        self._values.extend(values)
        self.log_ns.append(sample.log_ns)
        self.stamp_ns.append(sample.stamp_ns)

    def read(self, sample: Sample) -> tuple[float, ...] | None:
        """The numbers that are kept of a message; None: it holds none."""
        return ()

    def list_notes(self) -> list[str]:
        """What the user should know of the messages."""
        return [f"{self.topic}: {self.without} messages are left out: {self.LEFT_OUT}"] if self.without else []

    def check(self) -> None:
        """Raise InputError if there is no message that can be used."""
        if not self.log_ns:
            why = f": {self.without} are left out: {self.LEFT_OUT}" if self.without else ""
            raise InputError(f"{self.topic} holds no message that can be used{why}")


@contextmanager
def explained(path: Path, topic: str = "") -> Iterator[None]:
    """Raise every exception of the libraries that read logs as an InputError of one line."""
    try:
        yield
    except (InputError, WorkError, MemoryError, OSError):
        raise
    except Exception as error:
        mending = f" (it may be mended by {MENDING[path.suffix]})" if path.suffix in MENDING else ""
        name = shorten(str(path), 300)
        raise InputError(f"{name} cannot be read as a log: {topic}{one_line(error)}{mending}") from None
