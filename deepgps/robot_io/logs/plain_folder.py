"""A log as plain files: a folder ``images``, ``wheels.csv`` with angles, and ``poses.csv`` if poses are known.

An image's time is in ``images.csv``, or its name is its time: seconds, or nanoseconds if it has at least 16 digits.
Values that are empty or nan, as motion capture writes them where it sees nothing, are left out.
"""

import csv
import math
from collections.abc import Collection, Iterator
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
    """The files as topics of the same names, with messages like those of ROS."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.types = {name: kind for name, kind in TYPES.items() if (folder / name).exists()}
        self._images = _list_images(folder)
        self.counts = {IMAGES: len(self._images)}

    def read(self, topics: Collection[str]) -> Iterator[Sample]:
        for topic in topics:
            if topic == IMAGES:
                yield from (Sample(topic, ns, ns, self.folder / IMAGES / name) for ns, name in self._images)
                continue
            for time, *values in _read_table(self.folder / topic):
                ns = _read_ns(time)
                yield Sample(topic, ns, ns, [float(value) if value.strip() else math.nan for value in values])

    def decode(self, sample: Sample) -> Any:
        if sample.topic == IMAGES:
            if not sample.data.exists():
                raise InputError(f"{sample.data} is missing")
            return SimpleNamespace(format="", data=sample.data.read_bytes())
        if sample.topic == WHEELS:
            return SimpleNamespace(name=JOINTS, position=sample.data)
        x, y, yaw = sample.data
        yaw = yaw if math.isfinite(yaw) else math.nan  # which the reader of poses leaves out
        place = SimpleNamespace(x=x, y=y, z=0.0)
        turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        return SimpleNamespace(pose=SimpleNamespace(position=place, orientation=turn))


def _list_images(folder: Path) -> list[tuple[int, str]]:
    """Time [ns] and name of each image, by time."""
    if (folder / TIMES).is_file():
        rows = _read_table(folder / TIMES)
        return sorted((_read_ns(time), name.strip()) for time, name in rows if name.strip())
    files = [one for one in (folder / IMAGES).iterdir() if one.suffix.lower() in SUFFIXES]
    files = [one for one in files if not one.name.startswith("._")]  # which macOS adds
    stems = sorted((one.stem for one in files), key=lambda stem: (len(stem), stem))
    if len(stems) > 2 and all(stem.isdecimal() and len(stem) < SECOND_DIGITS for stem in stems):
        raise InputError(
            f"{folder / IMAGES}: images are named by their numbers, {stems[0]} to {stems[-1]}, which are no times; "
            f"list times and names in {TIMES} ({','.join(COLUMNS[TIMES])})"
        )
    return sorted((_read_name(one), one.name) for one in files)


def _read_name(image: Path) -> int:
    """The time that an image's name tells [ns]."""
    in_ns = image.stem.isdecimal() and len(image.stem) >= NANOSECOND_DIGITS
    try:
        ns = int(image.stem) if in_ns else _read_ns(image.stem)
    except (ValueError, OverflowError):
        raise InputError(f"{image}: its name is no time [s], and there is no {TIMES}") from None
    if abs(ns) > MAX_TIME_S * 1e9 or (in_ns and UPTIME_NS <= ns < SINCE_1970_NS):
        raise InputError(
            f"{image}: its name must be seconds, or nanoseconds since 1970, and there is no {TIMES}; is it in ms or us?"
        )
    return ns


def _read_ns(text: str) -> int:
    """Seconds as nanoseconds, without rounding those of 1970 to a quarter of a microsecond."""
    seconds, _, fraction = text.strip().partition(".")
    if fraction.isdecimal() and seconds.isdecimal():
        return int(seconds) * 10**9 + int(fraction[:9].ljust(9, "0"))
    return round(float(text) * 1e9)


def _read_table(path: Path) -> Iterator[list[str]]:
    """Rows of a CSV file without its header; raises InputError that names the first wrong line."""
    columns, wrong = COLUMNS[path.name], ""
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        try:
            head = next(reader, [])
            if tuple(name.strip() for name in head) != columns:
                raise InputError(f"{path}: its first line must be {','.join(columns)}, and is {quote(','.join(head))}")
            for row in filter(None, reader):
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
                    where = f"{path}: line {reader.line_num}"
                    raise InputError(f"{where}: time_s {quote(row[0])} must be seconds; is it in ms or ns?")
                if not math.isnan(numbers[0]):
                    yield row
        except UnicodeDecodeError:  # the file is decoded in blocks, before lines are counted
            raise InputError(f"{path} must be text in UTF-8: after line {reader.line_num} it is not") from None
        except csv.Error as error:
            raise InputError(f"{path}: line {reader.line_num}: {error}") from None
