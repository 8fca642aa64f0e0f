"""Checks before the work on a log begins."""

from pathlib import Path

from sim.errors import InputError
from sim.robot_log.mcap_file import check_file
from sim.settings import ImageFaultSettings, SimSettings


def check_log(path: Path, settings: SimSettings) -> None:
    """Raise InputError if a log of these settings cannot be written to a file."""
    check_file(path)
    if settings.world != "room" or settings.sensor != "fisheye":
        raise InputError(f"--log {path}: a log needs world room and sensor fisheye, for its pictures")
    if settings.image_faults != ImageFaultSettings():
        raise InputError(f"--log {path}: image_faults act on polar images, and a log has raw ones: leave them off")
