"""Small logs of a synthetic robot, in every container, with the faults of real logs.

The robot drives straight segments and turns in place below a ceiling with a random texture, which a fisheye sees.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Bag
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore

from sim.geometry import wrap

RADIUS_M, TRACK_M, TICK = 0.033, 0.16, 2 * np.pi / 4096
LENGTHS_M = (0.5, 0.7, 0.4, 0.6, 0.5, 0.7)
TURNS = (2.0, -1.5, 2.5, 1.8, -2.2)
SPEED_MPS, RATE_RPS, REST_S, STEP_S = 0.22, 1.5, 0.6, 0.005
WIDTH, HEIGHT, FOCAL_PX, CEILING_M, MAX_ANGLE = 96, 80, 32.0, 1.6, np.radians(68.0)
START_NS = 1_700_000_000_000_000_000
JOINT_STATE, IMAGE, COMPRESSED, INFO, POSE, RANGE = (
    f"sensor_msgs/msg/{name}" if name != "PoseStamped" else "geometry_msgs/msg/PoseStamped"
    for name in ("JointState", "Image", "CompressedImage", "CameraInfo", "PoseStamped", "Range")
)
ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS, CAMERA, CAMERA_INFO, TRUTH = "/joint_states", "/camera/image_raw", "/camera/camera_info", "/mocap/pose"
CONFIG: dict[str, Any] = {
    "wheels": {"radius_m": RADIUS_M, "track_m": TRACK_M, "lag_s": 0.05},
    "camera": {"topic": CAMERA, "info": CAMERA_INFO, "rings": 16, "sectors": 64},
    "drive": {"spacing_m": 0.1},
}


@dataclass(frozen=True)
class Note:
    """A message: its topic, type, times [ns] and fields."""

    topic: str
    kind: str
    log_ns: int
    stamp_ns: int
    fields: Mapping[str, Any]


@dataclass(frozen=True)
class Motion:
    """The drive: times (n,) [s], poses (n, 3), wheel angles (n, 2) [rad]."""

    time_s: np.ndarray
    pose: np.ndarray
    angle: np.ndarray


@lru_cache
def make_motion(lengths_m: Sequence[float] = LENGTHS_M, turns: Sequence[float] = TURNS) -> Motion:
    """The robot rests, drives, rests, turns, and so on; it speeds up and brakes within 0.3 s."""
    speed, rate = [np.zeros(int(REST_S / STEP_S))], [np.zeros(int(REST_S / STEP_S))]
    for length_m, turn in zip(lengths_m, [*turns, 0.0], strict=True):
        for amount, top, values, other in ((length_m, SPEED_MPS, speed, rate), (turn, RATE_RPS, rate, speed)):
            if amount:
                profile = _ramp(amount, top)
                values.append(profile)
                other.append(np.zeros(len(profile)))
            values.append(np.zeros(int(REST_S / STEP_S)))
            other.append(np.zeros(int(REST_S / STEP_S)))
    speeds, rates = np.concatenate(speed) * STEP_S, np.concatenate(rate) * STEP_S
    yaw = np.cumsum(rates)
    heading = yaw - rates / 2
    place = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]) * speeds[:, None], axis=0)
    travelled = np.cumsum(speeds)
    angle = np.column_stack([travelled - yaw * TRACK_M / 2, travelled + yaw * TRACK_M / 2]) / RADIUS_M
    return Motion(np.arange(len(yaw)) * STEP_S, np.column_stack([place, yaw]), angle)


def _ramp(amount: float, top: float) -> np.ndarray:
    """Speeds, one per step, that add up to an amount."""
    seconds = abs(amount) / top + 0.3
    time_s = np.arange(0.0, seconds, STEP_S)
    shape = np.minimum(1.0, np.minimum(time_s, seconds - time_s) / 0.3)
    return shape * amount / (shape.sum() * STEP_S)


@lru_cache
def make_texture() -> np.ndarray:
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (128, 128, 3)).astype(np.uint8)
    return cv2.resize(coarse, (1024, 1024), interpolation=cv2.INTER_CUBIC)


@lru_cache
def _rays() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where on the ceiling each pixel looks: ahead and left [m], and whether it looks anywhere."""
    column, row = np.meshgrid(np.arange(WIDTH) - (WIDTH - 1) / 2, np.arange(HEIGHT) - (HEIGHT - 1) / 2)
    theta = np.hypot(column, row) / FOCAL_PX
    away = CEILING_M * np.tan(np.minimum(theta, MAX_ANGLE))
    azimuth = np.arctan2(column, -row)  # the image's top is ahead, its right is the robot's left
    return away * np.cos(azimuth), away * np.sin(azimuth), theta <= MAX_ANGLE


def draw(pose: np.ndarray) -> np.ndarray:
    """The raw fisheye image (HEIGHT, WIDTH, 3) uint8 RGB at a pose (3,)."""
    ahead, left, seen = _rays()
    x = pose[0] + ahead * np.cos(pose[2]) - left * np.sin(pose[2])
    y = pose[1] + ahead * np.sin(pose[2]) + left * np.cos(pose[2])
    column, row = (((50.0 * axis) % 1023).astype(np.float32) for axis in (x, y))
    return cv2.remap(make_texture(), column, row, cv2.INTER_LINEAR) * seen[..., None].astype(np.uint8)


@lru_cache
def _draw_all(period_s: float) -> tuple[tuple[float, np.ndarray], ...]:
    motion = make_motion()
    times = np.arange(0.1, motion.time_s[-1], period_s)
    return tuple((time, draw(pose_at(motion, time))) for time in times.tolist())


def pose_at(motion: Motion, time_s: float) -> np.ndarray:
    return np.array([np.interp(time_s, motion.time_s, column) for column in motion.pose.T])


def make_notes(encoding: str = "rgb8", truth: bool = True, odometry: bool = False) -> list[Note]:
    """All messages of a log by their times of logging; joint states are 50 ms late, as TurtleBot3's."""
    motion, notes = make_motion(), []
    for time_s in np.arange(0.06, motion.time_s[-1], 0.05).tolist():
        late = [np.interp(time_s - 0.05, motion.time_s, wheel) for wheel in motion.angle.T]
        position = np.rint(np.array(late) / TICK) * TICK
        fields: dict[str, Any] = {"name": ["wheel_left_joint", "wheel_right_joint"], "position": position}
        kind = JOINT_STATE
        if odometry:
            kind, fields = ODOMETRY, {"pose": pose_at(motion, time_s - 0.05)}
        notes.append(_note(JOINTS, kind, time_s, 0.003, fields))
        if truth:
            notes.append(_note(TRUTH, POSE, time_s, 0.001, {"pose": pose_at(motion, time_s)}))
        notes.append(_note("/range/front", RANGE, time_s, 0.001, {}))
    for time_s, image in _draw_all(0.1):
        notes.append(_note(CAMERA_INFO, INFO, time_s, 0.01, {}))
        kind = IMAGE if "/" not in encoding else COMPRESSED
        notes.append(_note(CAMERA, kind, time_s, 0.01, encode(image, encoding)))
    return sort(notes)


def sort(notes: Sequence[Note]) -> list[Note]:
    return sorted(notes, key=lambda note: note.log_ns)


def _note(topic: str, kind: str, time_s: float, late_s: float, fields: Mapping[str, Any]) -> Note:
    stamp = START_NS + round(time_s * 1e9)
    return Note(topic, kind, stamp + round(late_s * 1e9), stamp, fields)


def encode(image: np.ndarray, encoding: str, pad: int = 0) -> dict[str, Any]:
    """Fields of an image in an encoding, with rows padded by some bytes; for image/jpeg and image/png, compressed."""
    if "/" in encoding:
        _, data = cv2.imencode(f".{encoding.rpartition('/')[2]}", image[..., ::-1])
        return {"format": "rgb8; jpeg compressed bgr8", "data": data.ravel()}
    rows = ENCODERS[encoding](image)
    rows = rows.reshape(len(rows), -1)
    padded = np.pad(rows, ((0, 0), (0, pad)), constant_values=255)
    step = padded.shape[1]
    return {
        "encoding": encoding,
        "height": image.shape[0],
        "width": image.shape[1],
        "step": step,
        "data": padded.ravel(),
    }


def _to_yuv422(image: np.ndarray, order: Sequence[int]) -> np.ndarray:
    yuv = cv2.cvtColor(image, cv2.COLOR_RGB2YUV)
    chroma = (yuv[:, 0::2, 1:].astype(int) + yuv[:, 1::2, 1:] + 1) // 2
    packed = np.stack([yuv[:, 0::2, 0], chroma[..., 0], yuv[:, 1::2, 0], chroma[..., 1]], axis=-1).astype(np.uint8)
    return packed[..., list(order)].reshape(image.shape[0], -1)


def _to_nv21(image: np.ndarray) -> np.ndarray:
    planes = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420).ravel()
    size = image.shape[0] * image.shape[1]
    u, v = planes[size : size * 5 // 4], planes[size * 5 // 4 :]
    return np.concatenate([planes[:size], np.stack([v, u], axis=-1).ravel()]).reshape(-1, image.shape[1])


def _to_mosaic(image: np.ndarray) -> np.ndarray:
    mosaic = image[..., 1].copy()
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = image[0::2, 0::2, 0], image[1::2, 1::2, 2]
    return mosaic


ENCODERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "rgb8": lambda image: image,
    "bgr8": lambda image: image[..., ::-1],
    "mono8": lambda image: cv2.cvtColor(image, cv2.COLOR_RGB2GRAY),
    "bgra8": lambda image: cv2.cvtColor(image, cv2.COLOR_RGB2BGRA),
    "rgba8": lambda image: cv2.cvtColor(image, cv2.COLOR_RGB2RGBA),
    "yuv422": lambda image: _to_yuv422(image, (1, 0, 3, 2)),
    "yuv422_yuy2": lambda image: _to_yuv422(image, (0, 1, 2, 3)),
    "nv21": _to_nv21,
    "bayer_rggb8": _to_mosaic,
}


def change(notes: Sequence[Note], topic: str, how: Callable[[int, Note], Note | None]) -> list[Note]:
    """The messages with those of a topic replaced, or left out, by their number."""
    changed, number = [], 0
    for note in notes:
        new: Note | None = note
        if note.topic == topic:
            new, number = how(number, note), number + 1
        if new is not None:
            changed.append(new)
    return sort(changed)


def set_fields(note: Note, **fields: Any) -> Note:
    return replace(note, fields={**note.fields, **fields})


def seconds(note: Note) -> float:
    """Time of a message from the beginning of the drive, by its stamp [s]."""
    return (note.stamp_ns - START_NS) * 1e-9


def write_log(path: Path, notes: Sequence[Note], form: str = "mcap") -> Path:
    """Write a log.

    Args:
        path: Its path without suffix.
        notes: Its messages.
        form: bag, db3, db3_zstd, db3_file_zstd, mcap or mcap_lz4; the last is one file.

    Returns:
        The log.
    """
    topics = {note.topic: note.kind for note in notes}
    if form == "mcap_lz4":
        return _write_lz4(path.with_suffix(".mcap"), notes)
    store = get_typestore(Stores.ROS1_NOETIC if form == "bag" else Stores.ROS2_HUMBLE)
    if form == "bag":
        bag, serialize = Bag(path := path.with_suffix(".bag")), store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        bag, serialize = Bag2(path, version=9, storage_plugin=plugin), store.serialize_cdr
        if form == "db3_zstd":
            bag.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        if form == "db3_file_zstd":
            bag.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with bag:
        links: Any = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        for note in notes:
            bag.write(links[note.topic], note.log_ns, serialize(make_message(store, note), note.kind))
    return path


def _write_lz4(path: Path, notes: Sequence[Note]) -> Path:
    store, links = get_typestore(Stores.ROS2_HUMBLE), dict[str, int]()
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=2**18, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library="test")
        for note in notes:
            if note.topic not in links:
                text, _ = store.generate_msgdef(note.kind, ros_version=2)
                schema = writer.register_schema(note.kind, "ros2msg", text.encode())
                links[note.topic] = writer.register_channel(note.topic, "cdr", schema)
            data = bytes(store.serialize_cdr(make_message(store, note), note.kind))
            writer.add_message(links[note.topic], note.log_ns, data, note.log_ns)
        writer.finish()
    return path


def make_message(store: Any, note: Note) -> Any:
    """The message with its header, of ROS 1 or 2."""

    def new(kind: str, **fields: Any) -> Any:
        return store.types[kind](**fields)

    whole, part = divmod(note.stamp_ns, 10**9)
    counter = {"seq": 0} if "seq" in new_fields(store, "std_msgs/msg/Header") else {}
    stamp = new("builtin_interfaces/msg/Time", sec=whole, nanosec=part)
    header, given = new("std_msgs/msg/Header", **counter, stamp=stamp, frame_id="base"), note.fields
    if note.kind == JOINT_STATE:
        none = np.empty(0)
        position = np.asarray(given["position"], float)
        return new(note.kind, header=header, name=given["name"], position=position, velocity=none, effort=none)
    if note.kind == IMAGE:
        return new(note.kind, header=header, is_bigendian=0, **given)
    if note.kind == COMPRESSED:
        return new(note.kind, header=header, **given)
    if note.kind == RANGE:
        return new(
            note.kind, header=header, radiation_type=1, field_of_view=0.0, min_range=0.0, max_range=4.0, range=1.0
        )
    if note.kind == INFO:
        return _make_info(store, header, given)
    return _make_pose(store, note.kind, header, given["pose"], given.get("length", 1.0))


def new_fields(store: Any, kind: str) -> list[str]:
    return [name for name, _ in store.fielddefs[kind][1]]


def _make_info(store: Any, header: Any, given: Mapping[str, Any]) -> Any:
    kind = INFO
    roi = store.types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    focal = given.get("focal", FOCAL_PX)
    k = np.array([focal, 0, (WIDTH - 1) / 2, 0, focal, (HEIGHT - 1) / 2, 0, 0, 1.0])
    arrays = {"d": np.array(given.get("d", np.zeros(4))), "k": k, "r": np.eye(3).ravel(), "p": np.zeros(12)}
    upper = "K" in new_fields(store, kind)
    arrays = {name.upper() if upper else name: value for name, value in arrays.items()}
    return store.types[kind](
        header=header,
        height=given.get("height", HEIGHT),
        width=WIDTH,
        distortion_model=given.get("model", "equidistant"),
        binning_x=0,
        binning_y=0,
        roi=roi,
        **arrays,
    )


def _make_pose(store: Any, kind: str, header: Any, pose: np.ndarray, length: float) -> Any:
    """A message of a pose, with a quaternion of some length."""
    x, y, yaw = map(float, pose)
    place = store.types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0)
    turn = store.types["geometry_msgs/msg/Quaternion"](
        x=0.0, y=0.0, z=length * np.sin(yaw / 2), w=length * np.cos(yaw / 2)
    )
    inner = store.types["geometry_msgs/msg/Pose"](position=place, orientation=turn)
    if kind == POSE:
        return store.types[kind](header=header, pose=inner)
    zero = store.types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    uncertain = store.types["geometry_msgs/msg/PoseWithCovariance"](pose=inner, covariance=np.zeros(36))
    twist = store.types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    moved = store.types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36))
    return store.types[kind](header=header, child_frame_id="base", pose=uncertain, twist=moved)


def write_plain(folder: Path, truth: bool = True) -> Path:
    """The same drive as a folder of plain files."""
    (folder / "images").mkdir(parents=True)
    motion, rows, poses = make_motion(), ["time_s,left_rad,right_rad"], ["time_s,x_m,y_m,yaw_rad"]
    for time_s in np.arange(0.05, motion.time_s[-1], 0.05).tolist():
        left, right = (np.interp(time_s, motion.time_s, wheel) for wheel in motion.angle.T)
        x, y, yaw = pose_at(motion, time_s)
        rows.append(f"{time_s:.3f},{left:.6f},{right:.6f}")
        poses.append(f"{time_s:.3f},{x:.6f},{y:.6f},{wrap(yaw):.6f}")
    (folder / "wheels.csv").write_text("\n".join(rows))
    if truth:
        (folder / "poses.csv").write_text("\n".join(poses))
    for time_s, image in _draw_all(0.1):
        cv2.imwrite(str(folder / "images" / f"{time_s:.3f}.png"), image[..., ::-1])
    return folder
