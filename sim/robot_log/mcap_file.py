"""The messages of a log, their ROS 2 types, and the MCAP file that holds them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from sim.errors import InputError
from sim.files.atomic import check_overwrite, write_atomic

CAMERA_FRAME, BASE_FRAME, MAP_FRAME = "camera", "base_footprint", "map"


@lru_cache(maxsize=1)
def type_store() -> Typestore:
    """The message types of ROS 2 Humble."""
    return get_typestore(Stores.ROS2_HUMBLE)


def make_joint_state(ns: int, names: Sequence[str], angle: np.ndarray, rim_mps: np.ndarray) -> Any:
    """Wheel angles (2,) [rad]. As TurtleBot3's, ``velocity`` holds the speed of the rims (2,) [m/s], not rad/s."""
    return _new(
        "sensor_msgs/msg/JointState",
        header=_header(ns, "base_link"),
        name=list(names),
        position=np.asarray(angle, float),
        velocity=np.asarray(rim_mps, float),
        effort=np.empty(0),
    )


def make_compressed_image(ns: int, data: np.ndarray, form: str, frame: str = CAMERA_FRAME) -> Any:
    """An image as the bytes of a file (n,) uint8 of the format ``form``."""
    return _new("sensor_msgs/msg/CompressedImage", header=_header(ns, frame), format=form, data=data)


def make_camera_info(ns: int, shape: tuple[int, int], focal_px: float, k: Sequence[float]) -> Any:
    """The calibration of an equidistant lens with its centre in the middle of the image (rows, columns) [px]."""
    (rows, columns), zero = shape, 0.0
    column, row = (columns - 1) / 2, (rows - 1) / 2
    matrix = [focal_px, zero, column, zero, focal_px, row, zero, zero, 1.0]
    return _new(
        "sensor_msgs/msg/CameraInfo",
        header=_header(ns, CAMERA_FRAME),
        height=rows,
        width=columns,
        distortion_model="equidistant",
        d=np.array(k, float),
        k=np.array(matrix),
        r=np.eye(3).reshape(-1),
        p=np.insert(np.array(matrix), (3, 6, 9), zero),
        binning_x=0,
        binning_y=0,
        roi=_new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def make_range(ns: int, frame: str, distance_m: float, reach_m: float) -> Any:
    """The distance along one ray; as REP-117 asks, infinite if nothing is within reach."""
    return _new(
        "sensor_msgs/msg/Range",
        header=_header(ns, frame),
        radiation_type=1,  # infrared light
        field_of_view=0.0,
        min_range=0.0,
        max_range=reach_m,
        range=distance_m if distance_m < reach_m else np.inf,
    )


def make_pose(ns: int, pose: np.ndarray) -> Any:
    """A planar pose (3,) in the frame of the map."""
    return _new("geometry_msgs/msg/PoseStamped", header=_header(ns, MAP_FRAME), pose=_pose(pose))


def make_uncertain_pose(ns: int, pose: np.ndarray, covariance: np.ndarray) -> Any:
    """A planar pose (3,) in the frame of the map, with its covariance (3, 3) [m, m, rad]."""
    full, rows = np.zeros((6, 6)), [0, 1, 5]
    full[np.ix_(rows, rows)] = covariance
    inner = _new("geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose), covariance=full.reshape(-1))
    return _new("geometry_msgs/msg/PoseWithCovarianceStamped", header=_header(ns, MAP_FRAME), pose=inner)


def make_transforms(ns: int, frames: Sequence[tuple[str, str, Sequence[float], float]]) -> Any:
    """Transforms, each from a parent to a child frame: translation (3,) [m], and rotation about z [rad]."""
    transforms = [
        _new(
            "geometry_msgs/msg/TransformStamped",
            header=_header(ns, parent),
            child_frame_id=child,
            transform=_new(
                "geometry_msgs/msg/Transform", translation=_vector(*place), rotation=_turn_about_z(float(yaw))
            ),
        )
        for parent, child, place, yaw in frames
    ]
    return _new("tf2_msgs/msg/TFMessage", transforms=transforms)


def _new(kind: str, **fields: Any) -> Any:
    return type_store().types[kind](**fields)


def _header(ns: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(int(ns), 10**9)
    return _new(
        "std_msgs/msg/Header",
        stamp=_new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds),
        frame_id=frame,
    )


def _pose(pose: np.ndarray) -> Any:
    x, y, yaw = map(float, pose)
    return _new(
        "geometry_msgs/msg/Pose",
        position=_new("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=_turn_about_z(yaw),
    )


def _vector(x: float, y: float, z: float) -> Any:
    return _new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))


def _turn_about_z(yaw: float) -> Any:
    return _new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))


MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "deepgps "
"""Beginning of the name of the writing program in the header of our files; a key of what they hold follows."""
HEADER_BYTES = 256  # Bytes at the beginning of a file that hold its header
PROGRESS_STRIDE = 2000  # Messages between two reports of progress


@dataclass(frozen=True)
class Topic:
    """The messages of one topic."""

    name: str  # Its name
    logged: np.ndarray  # When each message was recorded (n,) int64 [ns since 1970]
    make: Callable[[int], Any]  # Makes a message by its number


def check_file(path: Path) -> None:
    """Raise InputError unless a log may be written to this path."""
    if path.suffix != ".mcap":
        raise InputError(f"{path}: the name of a log must end in .mcap")
    check_overwrite(path, _is_ours, HEADER_BYTES)


def holds(path: Path, key: str) -> bool:
    """Whether a file is complete and was written with this key."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return _is_ours(head := file.read(HEADER_BYTES)) and f"{LIBRARY}{key}".encode() in head


def write_mcap(path: Path, topics: Sequence[Topic], key: str, progress: Callable[[int, int], None]) -> None:
    """Write a file aside and rename it when it is complete; ``holds`` recognises it by the key.

    Of messages that were recorded at the same time, those of an earlier topic come first. Raises WorkError if the disk
    is full, or writing fails.
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
        if done % PROGRESS_STRIDE == 0:
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
