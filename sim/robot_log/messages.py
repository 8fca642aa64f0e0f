"""ROS 2 messages of a robot's log. Times are nanoseconds since 1970, lengths metres, angles radians."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

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
