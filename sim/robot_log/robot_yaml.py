"""The description of the simulated robot that importing its log needs: what a user measures on a real one."""

from pathlib import Path

import yaml

from sim.files.checksums import write_lines
from sim.robot.model import TRACK_M, WHEEL_RADIUS_M
from sim.robot_log.check import ROBOT_HEAD, robot_file
from sim.robot_log.content import JOINTS
from sim.robot_log.pictures import ROWS
from sim.sensors.encoder import describe_odometry
from sim.settings import SimSettings


def write_robot(log: Path, settings: SimSettings) -> None:
    """Write the description of the robot beside its log."""
    camera, (left, right) = settings.camera, JOINTS
    odometry = describe_odometry(settings.encoder, WHEEL_RADIUS_M, TRACK_M)
    values = {
        "wheels": {
            "topic": "/joint_states",
            "left": left,
            "right": right,
            "radius_m": odometry["wheel_radius_m"],
            "track_m": odometry["track_m"],
            "ticks_per_rev": odometry["ticks_per_rev"],
            "lag_s": "estimate",  # half of it is the period that messages are late; the rest, how clocks are aligned
        },
        "camera": {
            "topic": "/camera/image_raw/compressed",
            "info": "/camera/camera_info",
            "field_of_view_deg": camera.field_of_view_deg,
            "circle_px": ROWS / 2,
            **{name: getattr(camera, name) for name in ("height_m", "rings", "sectors")},
        },
        "pose": {"topic": "/ground_truth/pose", "use": "truth"},
        "drive": {"spacing_m": settings.drive.spacing_m},
        "clocks": "align",
    }
    write_lines(robot_file(log), ROBOT_HEAD + yaml.safe_dump(values, sort_keys=False))
