"""Poses of images by a trained method, as they come."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from deepgps.api.run import Frame, Run
from deepgps.positioner.pose import Poses, find_poses
from deepgps.robot_io.locate.pictures import Picture
from deepgps.tracking.watch import Watch
from sim.errors import InputError, one_line
from sim.recording.format import read_manifest

Unwrap = Callable[[np.ndarray], np.ndarray]
"""Makes a polar image (rings, sectors, 3) of what the camera gives (height, width, 3), both uint8 RGB."""
Step = Callable[[str, Poses], Poses]
"""(name of an image, its own pose in the map) -> its pose by all images so far."""


class Located(NamedTuple):
    """An image and what was found.

    Attributes:
        picture: The image; its error says why nothing was found.
        polar: Its polar image; None like ``pose``.
        pose: Its pose; None: nothing was found.
        cause: Name of the cause for which it is refused or suspicious; empty: none. None: nobody asks.
    """

    picture: Picture
    polar: np.ndarray | None = None
    pose: Poses | None = None
    cause: str | None = None


def locate(
    run: Run,
    pictures: Iterable[Picture],
    unwrap: Unwrap,
    method: str | None,
    frame: Frame,
    step: Step | None = None,
    watch: Watch | None = None,
) -> Iterator[Located]:
    """Find the pose of each image when it comes.

    Args:
        run: A run whose methods have learned from polar images.
        pictures: The images.
        unwrap: Makes polar images; raises InputError where it cannot.
        method: The method; None: the first of the run.
        frame: Frame of the poses.
        step: Tracks the robot; None: each pose is of one image alone.
        watch: Names causes; None: nobody asks for them.

    Raises:
        InputError: The map has no place in the world.
    """
    alignment, positioner = run.alignment(method, frame), run.positioner(method)

    def find(picture: Picture) -> Located:
        if picture.image is None:
            return Located(picture)
        try:
            polar = unwrap(picture.image)
        except InputError as error:
            return Located(picture._replace(image=None, error=one_line(error)))
        pose = find_poses(positioner, polar[None]).take(0)
        cause = None
        if watch is not None:
            assert pose.novelty is not None  # a method whose images have causes knows how novel they are
            cause = watch.step(polar, float(pose.novelty))
        pose = pose if step is None else step(picture.name, pose)
        return Located(picture, polar, pose if alignment is None else pose.align(alignment), cause)

    return map(find, pictures)


def find_shape(run: Run) -> tuple[int, ...]:
    """Shape of the polar images that a run's methods take; raises InputError if they take something else."""
    kind = read_manifest(run.folder / "recording").kind
    if kind != "polar_image":
        raise InputError(f"{run.folder} has learned from observations of kind {kind}, and only images can be located")
    return tuple(run.recording.observation.shape[1:])


def describe(one: Located, frame: Frame) -> dict[str, Any]:
    """What is said of an image: numbers in metres, radians and seconds, null where a method does not know."""
    time = {} if one.picture.time_s is None else {"time": round(one.picture.time_s, 6)}
    name, pose = {"image": one.picture.name, **time}, one.pose
    if pose is None:
        return {**name, "error": one.picture.error}
    x, y = pose.position.tolist()
    return {
        **name,
        "x": _round(x),
        "y": _round(y),
        "yaw": _round(pose.yaw),
        "radius_68": _round(pose.radius_68),
        "radius_95": _round(pose.radius_95),
        "accepted": None if pose.accepted is None else bool(pose.accepted),
        **({} if one.cause is None else {"cause": one.cause or None}),
        "frame": frame,
    }


def _round(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 6)
