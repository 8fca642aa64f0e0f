"""The images of a robot's log in the order of the log, unwrapped by its calibration, with the robot's odometry."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from deepgps.data.checks import check_view
from deepgps.robot_io.locate.pictures import Picture
from deepgps.robot_io.logs.camera import PolarSource, open_polar
from deepgps.robot_io.logs.containers import Log, open_log
from deepgps.robot_io.logs.drive import LoggedDrive, find_drive
from deepgps.robot_io.logs.lag import choose_lag, measure_lag
from deepgps.robot_io.logs.messages import open_wheels
from deepgps.robot_io.logs.pictures import ImageList, open_images, take_images
from deepgps.robot_io.logs.robot_config import RobotConfig, load_config
from deepgps.robot_io.logs.segmentation import Path as Odometry
from deepgps.robot_io.logs.segmentation import find_path
from deepgps.terminal.progress import Report
from sim.errors import InputError

NS = 1e-9


@dataclass(frozen=True)
class LogSource:
    """A log that is read.

    Attributes:
        polar: What makes polar images of its images.
        listed: Times of the images.
        odometry: Distance and heading by the wheels at each image, NaN where they are not known; None: not asked for.
    """

    polar: PolarSource
    listed: ImageList
    odometry: Odometry | None

    def read(self) -> Iterator[Picture]:
        """Its images; one that cannot be decoded says why when the next one is read."""
        wanted, damaged = range(len(self.listed.log_ns)), dict[int, str]()
        for number, image in take_images(self.polar.log, self.polar.topic, wanted, damaged):
            yield from self._tell(damaged)
            yield Picture(str(number), image, time_s=self._time_s(number))
        yield from self._tell(damaged)

    def _tell(self, damaged: dict[int, str]) -> Iterator[Picture]:
        """Pictures without images for those that are damaged, which are then forgotten."""
        for number in sorted(damaged):
            yield Picture(str(number), None, damaged.pop(number), self._time_s(number))

    def _time_s(self, number: int) -> float:
        return NS * (self.listed.stamp_ns[number] or self.listed.log_ns[number])


@contextmanager
def open_source(
    path: Path, config: Path, field_of_view_deg: float | None, with_odometry: bool, progress: Report
) -> Iterator[LogSource]:
    """Open a log for reading.

    Args:
        path: The log.
        config: The ``robot.yaml`` with which it would be imported.
        field_of_view_deg: Full angle of the polar images, where the configuration does not set it; None: unknown.
        with_odometry: Whether its wheels are read, too.
        progress: Called with what is done before the first image.

    Raises:
        InputError: The log or its configuration cannot be used; one line says why.
    """
    robot = load_config(config)
    with open_log(path) as log:
        listed = open_images(log, robot.camera.topic)
        drive = _read(log, robot, listed, with_odometry, progress)
        view = {"field_of_view_deg": robot.camera.field_of_view_deg or field_of_view_deg}
        polar = open_polar(log, robot.camera.model_copy(update=view))
        yield LogSource(polar, listed, None if drive is None else _follow(robot, drive, polar, progress))


def _read(log: Log, robot: RobotConfig, listed: ImageList, with_wheels: bool, progress: Report) -> LoggedDrive | None:
    """Read the times of the images and the wheels; None: without wheels."""
    takers = {listed.topic: listed.take}
    wheels = open_wheels(log, robot.wheels) if with_wheels else None
    if wheels is not None:
        takers[robot.wheels.topic] = wheels.take
    log.feed(takers, progress)
    listed.check()
    if wheels is None:
        return None
    wheels.check()
    return find_drive(robot, wheels, listed, None)


def _follow(robot: RobotConfig, drive: LoggedDrive, polar: PolarSource, progress: Report) -> Odometry:
    """Distance and heading at each image, by the wheels when they were read later by their lag."""
    lag_s = robot.wheels.lag_s
    if lag_s == "estimate":
        with TemporaryFile() as file:
            lag_s, _ = choose_lag(lag_s, measure_lag(polar, drive, file, progress)[0])
    time_s = np.nan_to_num(drive.image_s, nan=-np.inf) + float(lag_s)
    angle = drive.wheels.at(time_s)
    angle[1:][np.diff(drive.wheels.count_breaks(time_s)) != 0] = np.nan  # the motion since the image before is unknown
    return find_path(angle, robot.wheels.radius_m, robot.wheels.track_m)


def check_images(polar: PolarSource, shape: tuple[int, ...], field_of_view_deg: float | None) -> None:
    """Raise InputError if a log's polar images are not like those that a run has learned from.

    Args:
        polar: The log's images.
        shape: Rings, sectors and colours of the run's.
        field_of_view_deg: Their full angle; None: unknown.
    """
    made = (polar.unwrap.rings, polar.unwrap.sectors, 3)
    if made != shape:
        raise InputError(f"camera.rings and camera.sectors {made[:2]}: the run has learned from {shape[:2]}")
    check_view(float(np.degrees(2 * polar.lens.half_angle)), field_of_view_deg)
