"""Checks before the work on a log begins."""

from pathlib import Path

from sim.errors import InputError
from sim.files import check_overwrite
from sim.robot_log.mcap_file import check_file
from sim.settings import ImageFaultSettings, SimSettings

ROBOT_HEAD = "# The robot of a simulated log, for deepgps import.\n"


def robot_file(log: Path) -> Path:
    """Path of the robot's description beside a log."""
    return log.with_suffix(".robot.yaml")


def check_log(path: Path, settings: SimSettings) -> None:
    """Raise InputError if a log of these settings, and the robot's description, cannot be written to these files."""
    check_file(path)
    check_overwrite(robot_file(path), lambda data: data.startswith(ROBOT_HEAD.encode()))
    if settings.world != "room" or settings.sensor != "fisheye":
        raise InputError(f"--log {path}: a log needs world room and sensor fisheye, for its pictures")
    if settings.robot.mjcf is not None:
        raise InputError(f"--log {path}: logs are of the testbed's own robot, and robot.mjcf is another")
    faults = {
        "image_faults": settings.image_faults != ImageFaultSettings(),
        "camera_mount.driven_m": settings.camera_mount.driven_m,
        "drive.mixed_light": settings.drive.mixed_light,
    }
    for name in (name for name, on in faults.items() if on):
        raise InputError(f"--log {path}: {name} is for polar images, and the raw ones of a log do not have it")
