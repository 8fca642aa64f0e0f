"""Poses of images by a trained method, as they come."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from deepgps.api.run import Frame, Run
from deepgps.locate.pictures import Picture
from deepgps.locate.unwrapping import Unwrapper
from deepgps.methods.pose import Poses, find_poses
from sim.errors import InputError, one_line
from sim.recording.format import read_manifest
from sim.sensors.unwrap import RoundImage


class Located(NamedTuple):
    """An image and what was found.

    Attributes:
        picture: The image; its error says why nothing was found.
        polar: Its polar image; None like ``pose``.
        pose: Its pose; None: nothing was found.
    """

    picture: Picture
    polar: np.ndarray | None = None
    pose: Poses | None = None


def locate(
    run: Run, pictures: Iterable[Picture], method: str | None, frame: Frame, circle: RoundImage | None
) -> Iterator[Located]:
    """Find the pose of each image when it comes.

    Args:
        run: A run whose methods have learned from polar images.
        pictures: The images.
        method: The method; None: the first of the run.
        frame: Frame of the poses.
        circle: Where the image circle is in raw images; None: it fills them.

    Raises:
        InputError: The method has learned from something else, or its map has no place in the world.
    """
    shape, alignment, positioner = find_shape(run), run.alignment(method, frame), run.positioner(method)
    unwrap = Unwrapper(shape, circle)

    def find(picture: Picture) -> Located:
        if picture.image is None:
            return Located(picture)
        try:
            polar = unwrap(picture.image)
        except InputError as error:
            return Located(picture._replace(image=None, error=one_line(error)))
        found = find_poses(positioner, polar[None])
        return Located(picture, polar, (found if alignment is None else found.align(alignment)).take(0))

    return map(find, pictures)


def find_shape(run: Run) -> tuple[int, ...]:
    """Shape of the polar images that a run's methods take; raises InputError if they take something else."""
    kind = read_manifest(run.folder / "recording").kind
    if kind != "polar_image":
        raise InputError(f"{run.folder} has learned from observations of kind {kind}, and only images can be located")
    return tuple(run.recording.observation.shape[1:])


def describe(one: Located, frame: Frame) -> dict[str, Any]:
    """What is said of an image: numbers in metres, radians and seconds, null where a method does not know."""
    name, pose = {"image": one.picture.name}, one.pose
    if pose is None:
        return {**name, "error": one.picture.error}
    time = {} if one.picture.time_s is None else {"time": round(one.picture.time_s, 6)}
    x, y = pose.position.tolist()
    return {
        **name,
        **time,
        "x": _round(x),
        "y": _round(y),
        "yaw": _round(pose.yaw),
        "radius_68": _round(pose.radius_68),
        "radius_95": _round(pose.radius_95),
        "accepted": None if pose.accepted is None else bool(pose.accepted),
        "frame": frame,
    }


def _round(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 6)
