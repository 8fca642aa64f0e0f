"""The messages of a log, of types of ROS 2 Humble, and the MCAP file that holds them, written by rosbags."""

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros

from sim.files.atomic import PART, write_atomic

JOINTS = ("wheel_left_joint", "wheel_right_joint")


def make_joint_state(ns: int, names: Sequence[str], angle: np.ndarray, rim_mps: np.ndarray) -> Any:
    """Wheel angles (2,) [rad]. As TurtleBot3's, ``velocity`` holds the speed of the rims (2,) [m/s], not rad/s."""
    header = _header(ns, "base_link")
    return ros.sensor_msgs__msg__JointState(header, list(names), angle.astype(float), rim_mps, np.empty(0))


def make_compressed_image(ns: int, data: np.ndarray, form: str, frame: str = "camera") -> Any:
    """An image as the bytes of a file (n,) uint8 of the format ``form``."""
    return ros.sensor_msgs__msg__CompressedImage(_header(ns, frame), form, data)


def make_camera_info(ns: int, shape: tuple[int, int], focal_px: float, k: Sequence[float]) -> Any:
    """The calibration of an equidistant lens with its centre in the middle of the image (rows, columns) [px]."""
    column, row = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    matrix = np.array([[focal_px, 0.0, column], [0.0, focal_px, row], [0.0, 0.0, 1.0]])
    projection = np.column_stack([matrix, np.zeros(3)]).reshape(-1)
    matrices = np.array(k, float), matrix.reshape(-1), np.eye(3).reshape(-1), projection
    whole = ros.sensor_msgs__msg__RegionOfInterest(0, 0, 0, 0, False)
    return ros.sensor_msgs__msg__CameraInfo(_header(ns, "camera"), *shape, "equidistant", *matrices, 0, 0, whole)


def make_pose(ns: int, pose: np.ndarray) -> Any:
    """A planar pose (3,) in the frame of the map."""
    return ros.geometry_msgs__msg__PoseStamped(_header(ns, "map"), _pose(pose))


def _header(ns: int, frame: str) -> Any:
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(int(ns), 10**9)), frame)


def _pose(pose: np.ndarray) -> Any:
    x, y, yaw = pose.tolist()
    turn = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
    return ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(x, y, 0.0), turn)


KEY = "deepgps"
"""Name of what was logged, among the data of its own that a file has in its metadata."""
TAIL_BYTES = 1 << 24  # Metadata and index of a file are within these last bytes: they are 0.1 % of its size
PROGRESS_STRIDE = 2000  # Messages between two reports of progress


@dataclass(frozen=True)
class Topic:
    """The messages of one topic."""

    name: str  # Its name
    logged: np.ndarray  # When each message was recorded (n,) int64 [ns since 1970]
    make: Callable[[int], Any]  # Makes a message by its number


def read_key(path: Path) -> str | None:
    """The key with which a file was written; None: there is no such file, or it is not one of ours."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - TAIL_BYTES, 0))
        found = re.search(rb"custom_data:\s+%b: '?([^'\n]+)'?\n" % KEY.encode(), file.read())
    return found and found[1].decode(errors="replace")


def write_mcap(path: Path, topics: Sequence[Topic], key: str, progress: Callable[[int, int], None]) -> None:
    """Write a file aside and rename it when it is complete; ``read_key`` finds the key in it.

    Of messages that were recorded at the same time, those of an earlier topic come first. Raises WorkError if the disk
    is full, or writing fails.
    """

    bag = path.with_name(f"{path.name}{PART}") / path.stem  # rosbags writes a folder with the file in it

    def write(part: Path) -> None:
        shutil.rmtree(bag.parent, ignore_errors=True)  # of a process that was stopped
        try:
            writer = Writer(bag, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            writer.set_custom_data(KEY, key)
            with writer:
                _write(writer, topics, progress)
            (bag / path.name).replace(part)
        finally:
            shutil.rmtree(bag.parent, ignore_errors=True)

    write_atomic(path, write)


def _write(writer: Writer, topics: Sequence[Topic], progress: Callable[[int, int], None]) -> None:
    store, connections = get_typestore(Stores.ROS2_HUMBLE), dict[str, Any]()
    rows = [(ns, number, row) for number, topic in enumerate(topics) for row, ns in enumerate(topic.logged.tolist())]
    for done, (ns, number, row) in enumerate(sorted(rows)):
        if done % PROGRESS_STRIDE == 0:
            progress(done, len(rows))
        message, name = topics[number].make(row), topics[number].name
        kind = message.__msgtype__
        if name not in connections:
            connections[name] = writer.add_connection(name, kind, typestore=store)
        writer.write(connections[name], ns, store.serialize_cdr(message, kind))
    progress(len(rows), len(rows))
