"""A log as plain files: a folder ``images``, ``wheels.csv`` with angles, and ``poses.csv`` if poses are known.

``wheels.csv`` has the columns time_s, left_rad, right_rad; ``poses.csv`` time_s, x_m, y_m, yaw_rad. An image's time is
in ``images.csv`` (time_s, file), or its name is its time: seconds, or nanoseconds if it has at least 16 digits. Times
beyond the year 2255, and names that are microseconds since 1970 or mere numbers, are refused. Values that are empty or
nan, as motion capture writes them where it sees nothing, and a last line that was cut off, are left out.
"""

import csv
import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from deepgps.robot_io.logs.sample import Sample
from sim.errors import InputError, quote

IMAGES, WHEELS, POSES, TIMES = "images", "wheels.csv", "poses.csv", "images.csv"
TYPES = {
    IMAGES: "sensor_msgs/msg/CompressedImage",
    WHEELS: "sensor_msgs/msg/JointState",
    POSES: "geometry_msgs/msg/PoseStamped",
}
COLUMNS = {
    WHEELS: ("time_s", "left_rad", "right_rad"),
    POSES: ("time_s", "x_m", "y_m", "yaw_rad"),
    TIMES: ("time_s", "file"),
}
JOINTS = ["left", "right"]
SUFFIXES = {".jpg", ".jpeg", ".png"}
SECOND_DIGITS, NANOSECOND_DIGITS = 10, 16
"""Digits of whole seconds, and of nanoseconds, since 1970; with fewer, a name is a number and no time."""
MAX_TIME_S = 9e9  # Largest plausible time [s]: in the year 2255. Milliseconds since 1970 are larger
UPTIME_NS, SINCE_1970_NS = 10**15, 10**18
"""Names in nanoseconds are below the one, by a clock that began with the robot, or from the other on, since 1970 [ns].
Those between are microseconds since 1970."""


def is_plain(path: Path) -> bool:
    """Whether a path is a log of plain files."""
    return (path / WHEELS).is_file() and (path / IMAGES).is_dir()


class PlainFolder:
    """The files as topics of the same names, with messages like those of ROS.

    Attributes:
        types: Type of each topic.
        counts: Number of images, and of rows of the tables, by topic.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.types = {name: kind for name, kind in TYPES.items() if (folder / name).exists()}
        self._images = _list_images(folder)
        tables = {name: _count_rows(folder / name) for name in self.types if name != IMAGES}
        self.counts = {IMAGES: len(self._images), **tables}

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        for topic in topics:
            if topic == IMAGES:
                yield from (Sample(topic, ns, ns, self.folder / IMAGES / name) for ns, name in self._images)
            else:
                for values in _read_table(self.folder / topic):
                    ns = _read_ns(values[0])
                    yield Sample(
                        topic, ns, ns, tuple(float(value) if value.strip() else math.nan for value in values[1:])
                    )

    def decode(self, sample: Sample) -> Any:
        if sample.topic == IMAGES:
            return SimpleNamespace(format="", data=_read_image(sample.data))
        if sample.topic == WHEELS:
            return SimpleNamespace(name=JOINTS, position=list(sample.data))
        x, y, yaw = sample.data
        yaw = yaw if math.isfinite(yaw) else math.nan  # which the reader of poses leaves out
        place = SimpleNamespace(x=x, y=y, z=0.0)
        turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        return SimpleNamespace(pose=SimpleNamespace(position=place, orientation=turn))


def _read_image(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path} is missing") from None


def _list_images(folder: Path) -> list[tuple[int, str]]:
    """Time [ns] and name of each image, by time."""
    if (folder / TIMES).is_file():
        rows = _read_table(folder / TIMES)
        return sorted((_read_ns(time), name.strip()) for time, name in rows if name.strip())
    files = (file for file in (folder / IMAGES).iterdir() if file.suffix.lower() in SUFFIXES)
    names = [file.name for file in files if not file.name.startswith("._")]  # which macOS adds
    _refuse_numbers(folder, names)
    return sorted((_read_name(folder, name), name) for name in names)


def _refuse_numbers(folder: Path, names: Sequence[str]) -> None:
    """Raise InputError if images are named by their numbers: these are no times."""
    stems = sorted((name.rpartition(".")[0] for name in names), key=lambda stem: (len(stem), stem))
    if len(stems) > 2 and all(stem.isdecimal() and len(stem) < SECOND_DIGITS for stem in stems):
        raise InputError(
            f"{folder / IMAGES}: images are named by their numbers, {stems[0]} to {stems[-1]}, which are no times; "
            f"list times and names in {TIMES} ({','.join(COLUMNS[TIMES])})"
        )


def _read_name(folder: Path, name: str) -> int:
    """The time that an image's name tells [ns]."""
    stem = name.rpartition(".")[0]
    in_ns = stem.isdecimal() and len(stem) >= NANOSECOND_DIGITS
    try:
        ns = int(stem) if in_ns else _read_ns(stem)
    except (ValueError, OverflowError):
        raise InputError(f"{folder / IMAGES / name}: its name is no time [s], and there is no {TIMES}") from None
    if abs(ns) > MAX_TIME_S * 1e9 or (in_ns and UPTIME_NS <= ns < SINCE_1970_NS):
        raise InputError(
            f"{folder / IMAGES / name}: its name must be seconds, or nanoseconds since 1970, and there is no {TIMES}; "
            "is it in ms or us?"
        )
    return ns


def _read_ns(text: str) -> int:
    """Seconds as nanoseconds, without rounding those of 1970 to a quarter of a microsecond."""
    seconds, _, fraction = text.strip().partition(".")
    if fraction.isdecimal() and seconds.isdecimal():
        return int(seconds) * 10**9 + int(fraction[:9].ljust(9, "0"))
    return round(float(text) * 1e9)


def _count_rows(path: Path) -> int:
    with path.open("rb") as file:
        return max(sum(1 for _ in file) - 1, 0)


def _read_table(path: Path) -> Iterator[list[str]]:
    """Rows of a CSV file without its header; raises InputError that names the first wrong line."""
    columns = COLUMNS[path.name]
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        rows = _read_rows(reader, path)
        head = next(rows, [])
        if tuple(name.strip() for name in head) != columns:
            raise InputError(f"{path}: its first line must be {','.join(columns)}, and is {quote(','.join(head))}")
        wrong = None
        for row in filter(None, rows):
            if wrong:
                raise InputError(wrong)
            try:
                numbers = [float(value) for value in (row[:1] if "file" in columns else row) if value.strip()]
                if len(row) != len(columns) or not row[0].strip() or math.isinf(numbers[0]):
                    raise ValueError
            except ValueError:  # a last line was cut off; any other is an error
                wrong = f"{path}: line {reader.line_num} must be {','.join(columns)}, and is {quote(row)}"
                continue
            if abs(numbers[0]) > MAX_TIME_S:
                raise InputError(
                    f"{path}: line {reader.line_num}: time_s {quote(row[0])} must be seconds; is it in ms or ns?"
                )
            if not math.isnan(numbers[0]):
                yield row


def _read_rows(reader: Any, path: Path) -> Iterator[list[str]]:
    """Rows of a CSV reader; raises InputError that names where the file cannot be read."""
    try:
        yield from reader
    except UnicodeDecodeError:  # the file is decoded in blocks, before lines are counted
        where = f": after line {reader.line_num} it is not" if reader.line_num else ""
        raise InputError(f"{path} must be text in UTF-8{where}") from None
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: {error}") from None
