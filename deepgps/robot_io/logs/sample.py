"""A message of a log, a part of a log, and errors of those who read them in one line."""

from array import array
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from sim.errors import InputError, WorkError, one_line, shorten

MENDING = {".bag": "rosbag reindex", ".db3": "sqlite3 with .recover, then ros2 bag reindex", ".mcap": "mcap recover"}
"""What mends a damaged file, by its suffix."""


class Sample(NamedTuple):
    """A message of a log."""

    topic: str  # Its topic
    log_ns: int  # When it was logged, by the recorder's clock [ns]
    stamp_ns: int  # Its header's stamp, by the clock of who sent it [ns]; 0: it has none
    data: Any  # The message as it is stored, for ``Part.decode``


class Part(Protocol):
    """A part of a log."""

    types: dict[str, str]  # Type of each topic, such as ``sensor_msgs/msg/JointState``
    counts: dict[str, int]  # Number of messages of each topic where an index tells it

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        """The messages of some topics."""
        ...

    def decode(self, sample: Sample) -> Any:
        """The message with its fields; raises InputError if it is damaged."""
        ...


@dataclass
class Heard:
    """Times of a topic's messages, in the order of the files."""

    topic: str  # The topic
    log_ns: array = field(default_factory=lambda: array("q"), init=False)  # When each was logged (n,) [ns]
    stamp_ns: array = field(default_factory=lambda: array("q"), init=False)  # Its stamp (n,) [ns]; 0: none

    def take(self, sample: Sample, part: Part) -> None:
        """Note the times of a message."""
        self.log_ns.append(sample.log_ns)
        self.stamp_ns.append(sample.stamp_ns)


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
