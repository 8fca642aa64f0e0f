"""A log as plain files: a folder ``images``, ``wheels.csv`` with angles, and ``poses.csv`` if poses are known.

An image's time is in ``images.csv``, or its name is its time: seconds with a point, or at least 16 digits: nanoseconds.
Values that are empty or nan, as motion capture writes them where it sees nothing, are left out.
"""

import math
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from deepgps.robot_io.logs.sample import Part, Sample
from sim.errors import InputError, quote, read_file

IMAGES, WHEELS, POSES, TIMES = "images", "wheels.csv", "poses.csv", "images.csv"
TYPES = {
    IMAGES: "sensor_msgs/msg/CompressedImage",
    WHEELS: "sensor_msgs/msg/JointState",
    POSES: "geometry_msgs/msg/PoseStamped",
}
COLUMNS = {
    WHEELS: ["time_s", "left_rad", "right_rad"],
    POSES: ["time_s", "x_m", "y_m", "yaw_rad"],
    TIMES: ["time_s", "file"],
}
JOINTS = ["left", "right"]
SUFFIXES = {".jpg", ".jpeg", ".png"}
MAX_IMAGE_BYTES = 10**9
MAX_TIME_S = 9 * 10**9  # Largest plausible time [s]: in the year 2255. Milliseconds since 1970 are larger
NANOSECOND_DIGITS, UPTIME_NS, SINCE_1970_NS = 16, 10**15, 10**18
"""A name of so many digits is a time in nanoseconds: below the one, by a clock that began with the robot, or from the
other on, since 1970 [ns]. Those between are microseconds since 1970."""


def open_folder(folder: Path) -> Part:
    """The files as topics of the same names, with messages like those of ROS."""
    images = _list_images(folder)

    def read(topics: Collection[str]) -> Iterator[Sample]:
        for topic in topics:
            rows = images if topic == IMAGES else _read_table(folder / topic)
            yield from (Sample(topic, ns, ns, partial(_make_message, folder, topic, *values)) for ns, *values in rows)

    types = {name: kind for name, kind in TYPES.items() if (folder / name).exists()}
    return Part(types, {IMAGES: len(images)}, read)


def _make_message(folder: Path, topic: str, *values: str) -> Any:
    if topic == IMAGES:
        return SimpleNamespace(
            format="", data=read_file(path := folder / IMAGES / values[0], MAX_IMAGE_BYTES, str(path))
        )
    numbers = [float(value or math.nan) for value in values]
    if topic == WHEELS:
        return SimpleNamespace(name=JOINTS, position=numbers)
    x, y, yaw = (
        value if math.isfinite(value) else math.nan for value in numbers
    )  # which the reader of poses leaves out
    turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=x, y=y), orientation=turn))


def _list_images(folder: Path) -> list[tuple[int, str]]:
    """Time [ns] and name of each image, by time."""
    if (folder / TIMES).is_file():
        return sorted((ns, name) for ns, name in _read_table(folder / TIMES) if name)
    files = [one for one in (folder / IMAGES).iterdir() if one.suffix.lower() in SUFFIXES]
    files = [one for one in files if not one.name.startswith("._")]  # which macOS adds
    return sorted((_read_name(one), one.name) for one in files)


def _read_name(image: Path) -> int:
    """The time that an image's name tells [ns]."""
    name = image.stem
    with suppress(ArithmeticError, ValueError):
        if not name.isdecimal() and abs(time_s := float(name)) <= MAX_TIME_S:
            return round(time_s * 1e9)
        if len(name) >= NANOSECOND_DIGITS and not UPTIME_NS <= (ns := int(name)) < SINCE_1970_NS:
            return ns
    raise InputError(
        f"{image}: its name is no time: it must be seconds with a point, such as 12.345, or nanoseconds; or list times "
        f"and names in {TIMES} ({','.join(COLUMNS[TIMES])})"
    )


def _read_table(path: Path) -> Iterator[tuple[Any, ...]]:
    """Time [ns] and cells of the rows of a CSV file; raises InputError that names the first wrong line, unless it is
    the last, which was cut off."""
    columns, wrong = COLUMNS[path.name], ""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        head = [name.strip() for name in file.readline().split(",")]
        if head != columns:
            raise InputError(f"{path}: its first line must be {','.join(columns)}, and is {quote(','.join(head))}")
        for number, line in enumerate(file, start=2):
            if not line.strip():
                continue
            if wrong:
                raise InputError(wrong)
            cells = [cell.strip() for cell in line.split(",")]
            try:
                numbers = [float(cell or math.nan) for cell in (cells[:1] if path.name == TIMES else cells)]
            except ValueError:
                numbers = [math.inf]
            if len(cells) != len(columns) or math.isinf(numbers[0]):
                wrong = f"{path}: line {number} must be {','.join(columns)}, and is {quote(line.strip())}"
            elif abs(numbers[0]) > MAX_TIME_S:
                raise InputError(f"{path}: line {number}: time_s {quote(cells[0])} must be seconds; is it in ms or ns?")
            elif not math.isnan(numbers[0]):
                yield round(numbers[0] * 1e9), *cells[1:]
