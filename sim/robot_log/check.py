"""Checks before the work on a log begins."""

from pathlib import Path

from sim.errors import DamagedError, InputError
from sim.files.atomic import check_overwrite
from sim.files.checksums import check_lines
from sim.robot_log.mcap_file import check_file
from sim.settings import ImageFaultSettings, SimSettings

ROBOT_HEAD = "# The robot of a simulated log, for deepgps import.\n"


def robot_file(log: Path) -> Path:
    """Path of the robot's description beside a log."""
    return log.with_suffix(".robot.yaml")


def _check_robot(path: Path) -> None:
    """Raise InputError if a robot's description is not as deepgps wrote it."""
    check_overwrite(path, lambda data: ROBOT_HEAD.encode() in data)
    try:
        if path.exists():
            check_lines(path)
    except DamagedError:
        raise InputError(
            f"{path} was edited, or is of an earlier version, and would be overwritten: move it away, or give the "
            "log another name"
        ) from None


def check_log(path: Path, settings: SimSettings) -> None:
    """Raise InputError if a log of these settings, and the robot's description, cannot be written to these files."""
    check_file(path)
    _check_robot(robot_file(path))
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
        raise InputError(f"--log {path}: {name} applies to polar images, and a log holds raw ones; leave it out")
