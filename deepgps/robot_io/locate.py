"""Poses of images by a trained method as they come, each alone or tracked by a log's odometry."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from scipy.spatial import KDTree

from deepgps.api.run import Frame, Run
from deepgps.data.checks import check_view, find_view
from deepgps.learning.trainer import use_threads
from deepgps.positioner.pose import Poses, find_poses
from deepgps.positioner.registration import LEVELS, find_normal_radius
from deepgps.robot_io.sources import Picture, Unwrapper, open_pictures, open_source
from deepgps.terminal.progress import Report
from deepgps.tracking.causes import Watch, make_monitor
from deepgps.tracking.filter import advance, begin, estimate
from deepgps.tracking.fix import take_fix
from deepgps.tracking.motion import Motion, make_motion, mirror
from sim.errors import InputError, one_line
from sim.recording.format import read_manifest
from sim.sensors.camera.unwrap import RoundImage


def find_shape(run: Run) -> tuple[int, ...]:
    """Shape of the polar images that a run's methods take; raises InputError if they take something else."""
    kind = read_manifest(run.folder / "recording").kind
    if kind != "polar_image":
        raise InputError(f"{run.folder} has learned from observations of kind {kind}, and only images can be located")
    return tuple(run.recording.observation.shape[1:])


def describe(one: Picture, frame: Frame) -> dict[str, Any]:
    """What is said of an image: numbers in metres, radians and seconds, null where a method does not know."""
    time, pose = {} if one.time_s is None else {"time": round(one.time_s, 6)}, one.pose
    if pose is None:
        return {"image": one.name, **time, "error": one.error}
    x, y = pose.position.tolist()
    numbers = {"x": x, "y": y, "yaw": pose.yaw, "radius_68": pose.radius_68, "radius_95": pose.radius_95}
    return {
        "image": one.name,
        **time,
        **{name: _round(value) for name, value in numbers.items()},
        "accepted": None if pose.accepted is None else bool(pose.accepted),
        **({} if one.cause is None else {"cause": one.cause or None}),
        "frame": frame,
    }


def _round(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 6)


@contextmanager
def locate_source(
    run: Run,
    source: str,
    stdin: BinaryIO,
    progress: Report,
    *,
    method: str | None,
    frame: Frame,
    circle: RoundImage | None = None,
    config: Path | None = None,
    track: bool = False,
    causes: bool = False,
) -> Iterator[Iterator[Picture]]:
    """Locate the images of an image file, a folder, ``-`` or, with ``config``, a log, each when it is asked for; a
    located picture's image is the polar one.

    Without a ``circle``, raw images are filled by the image circle. With ``track``, poses are those of a robot that is
    tracked by the log's wheels; ``causes`` are named if asked for. Raises InputError if the run, the source or the
    options cannot be used.
    """
    shape, name = find_shape(run), run.choose(method)
    alignment, positioner = run.alignment(method, frame), run.positioner(method)
    for wrong, why in (
        (track and config is None, "--track needs the wheels of a log: --config robot.yaml"),
        (circle and config, "--centre and --radius-px: a log's camera is described by --config"),
        (
            track and positioner.mirrored is None,
            f"--track: method {name} gives no yaw, so its map may be mirrored",
        ),
    ):
        if wrong:
            raise InputError(why)
    with use_threads(run.scenario.learn.train.threads), ExitStack() as stack:
        monitor = make_monitor(positioner, run.recording) if causes else None
        if causes and monitor is None:
            raise InputError(f"--causes: method {name} refuses no images")
        watch, odometry = None if monitor is None else Watch(monitor), None
        tracker = Tracker(bool(positioner.mirrored), positioner.mapped)
        if config is None:
            pictures, unwrap = open_pictures(source, stdin), Unwrapper(shape, circle)
        else:
            view_deg = find_view(run.recording)
            polar, pictures, odometry = stack.enter_context(
                open_source(Path(source), config, view_deg, track, progress)
            )
            if polar.shape != shape:
                raise InputError(
                    f"camera.rings and camera.sectors {polar.shape[:2]}: the run has learned from {shape[:2]}"
                )
            check_view(float(np.degrees(2 * polar.lens.half_angle)), view_deg)
            unwrap = polar.unwrap

        def find(one: Picture) -> Picture:
            if one.image is None:
                return one
            try:
                polar = unwrap(one.image)
            except InputError as error:
                return one._replace(image=None, error=one_line(error))
            pose = find_poses(positioner, polar[None]).take(0)
            if odometry is not None:
                number = int(one.name)
                pose = tracker.step(pose, float(odometry.travelled_m[number]), float(odometry.yaw[number]))
            pose = pose if alignment is None else pose.align(alignment)
            return one._replace(image=polar, pose=pose, cause=None if watch is None else watch.step(polar))

        yield map(find, pictures)


DISTANCE_STD_SHARE, MIN_DISTANCE_STD_M = 0.01, 0.001  # Of the way between two images, as a part of it and at least [m]
REST_DISTANCE_M, REST_TURN_RAD = 1e-4, 1e-3
"""Way and turn between two images up to which the robot rests, so that they share all their errors [m], [rad]."""
TURN_STD_SHARE, MIN_TURN_STD_RAD = 0.1, 0.01  # Of the turn between two images, as a part of it and at least [rad]


class Tracker:
    """Tracks the robot through a stream of images; ``mirrored``: to the left is to the right in the method's map, which
    is of images at the places ``mapped``."""

    def __init__(self, mirrored: bool, mapped: KDTree | None = None) -> None:
        self._mirrored, self._state = mirrored, begin(mapped)
        self._travelled_m, self._yaw = np.nan, np.nan  # at the last image, by odometry

    def step(self, pose: Poses, travelled_m: float, yaw: float) -> Poses:
        """The tracked pose at an image, by its own pose and the distance [m] and heading [rad] by the wheels or NaN."""
        motion = self._find_motion(travelled_m, yaw)
        self._travelled_m, self._yaw = travelled_m, yaw
        self._state = advance(self._state, motion, take_fix(pose))
        found = estimate(self._state)
        radius = found.position_std * find_normal_radius(np.array(LEVELS))
        return Poses(
            found.position,
            yaw=np.asarray(found.yaw),
            yaw_std=np.asarray(found.yaw_std),
            radius_68=radius[0],
            radius_95=radius[1],
            accepted=np.asarray(found.accepted),
        )

    def _find_motion(self, travelled_m: float, yaw: float) -> Motion | None:
        """The motion since the last image; None: it is not known."""
        distance, turn = travelled_m - self._travelled_m, yaw - self._yaw
        if not np.isfinite([distance, turn]).all():
            return None
        rests = abs(distance) < REST_DISTANCE_M and abs(turn) < REST_TURN_RAD
        # The robot turns and drives at the same time: half of the turn comes first.
        motion = make_motion(
            distance * np.cos(turn / 2),
            distance * np.sin(turn / 2),
            turn,
            DISTANCE_STD_SHARE * abs(distance) + (0.0 if rests else MIN_DISTANCE_STD_M),
            TURN_STD_SHARE * abs(turn) + (0.0 if rests else MIN_TURN_STD_RAD),
        )
        return mirror(motion) if self._mirrored else motion
