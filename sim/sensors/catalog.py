"""The sensors by name, one record each. This module imports nothing heavy: manifests and the viewer use it."""

from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, Literal, NamedTuple

import numpy as np

from sim.settings import SimSettings

ObservationKind = Literal["polar_image", "scan", "vector", "image"]
"""polar_image: fisheye images around the zenith; scan: a lidar's distances; vector: distances to landmarks;
image: any other picture, which no method learns from."""
Measure = Callable[[np.ndarray], np.ndarray]
"""Turns ideal observations (n, ...) into those that the sensor measures, in the order taken."""


class Opened(NamedTuple):
    """A sensor that is ready to observe."""

    # (state (nq,), lean of the fisheye camera (2,) [rad] or None) -> the ideal observation
    sense: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
    renderer: str = "none"  # Name of the OpenGL renderer


class Measures(NamedTuple):
    """What a sensor makes of ideal observations in each part of a recording; None: they stay ideal."""

    drive: Measure | None = None  # For the observations of the drive
    test: Measure | None = None  # For those at test positions
    turn: Measure | None = None  # For those after turns in place


@dataclass(frozen=True)
class Sensor:
    """The record of a sensor. Functions are named "module:function", with modules from ``sim``."""

    title: str  # Its name in the viewer
    kind: ObservationKind  # Kind of its observations
    carried: Callable[[SimSettings], bool]  # Settings -> whether the robot has it
    size: Callable[[SimSettings], int]  # Settings -> bytes of one observation
    # (settings, function that makes the compiled scene) -> ``Opened``; only sensors in a room have it
    open: str | None = None
    # Settings -> whether a recording keeps its observations
    kept: Callable[[SimSettings], bool] = lambda settings: True
    renders: bool = False  # Whether it needs OpenGL
    # (robot's model, settings) -> None; puts it on the robot. None: the robot's file has it, or it needs none
    mount: str | None = None
    make_measures: str | None = None  # (settings, seed) -> ``Measures``. None: observations are always ideal
    # Observations (n, ...) -> a dataclass of arrays found in them, which a part's file holds as well
    extract: str | None = None


SENSORS: dict[str, Sensor] = {
    "landmarks": Sensor(
        "Distances to landmarks",
        "vector",
        carried=lambda settings: settings.world == "landmarks",
        size=lambda settings: 4 * settings.landmarks.count,
    ),
    "fisheye": Sensor(
        "Fisheye",
        "polar_image",
        carried=lambda settings: settings.world == "room" and settings.sensor == "fisheye",
        size=lambda settings: settings.camera.rings * settings.camera.sectors * 3,
        open="sensors.camera.fisheye_images:open_fisheye",
        renders=True,
        make_measures="sensors.camera.faults:make_measures",
    ),
    "lidar": Sensor(
        "Lidar",
        "scan",
        carried=lambda settings: (
            settings.world == "obstacles" or (settings.world == "room" and settings.sensor == "lidar")
        ),
        size=lambda settings: 4 * settings.lidar.headings * settings.lidar.rays,
        open="sensors.lidar:open_lidar",
        make_measures="sensors.lidar_scan:make_measures",
    ),
    "tag_camera": Sensor(
        "Tag camera",
        "image",
        carried=lambda settings: settings.tag_camera.mounted,
        size=lambda settings: settings.tag_camera.height_px * settings.tag_camera.width_px,
        open="sensors.camera.tag_camera:open_tag_camera",
        kept=lambda settings: settings.tag_camera.kept,
        renders=True,
        mount="sensors.camera.tag_camera:mount",
        extract="apriltag.detector:find_tags",
    ),
}
"""Methods learn from the first one that the robot carries."""


def list_carried(settings: SimSettings) -> list[str]:
    """Names of the sensors that the robot carries."""
    return [name for name, sensor in SENSORS.items() if sensor.carried(settings)]


def list_kept(settings: SimSettings) -> list[str]:
    """Names of the sensors whose observations a recording keeps."""
    return [name for name in list_carried(settings) if SENSORS[name].kept(settings)]


def load(name: str) -> Callable[..., Any]:
    """Import the function "module:function" from a module of ``sim``."""
    return resolve_name(f"sim.{name}")
