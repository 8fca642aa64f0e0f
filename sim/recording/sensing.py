"""Sensing of robot states in worker processes; each process opens its cameras once and keeps them."""

import os
import zlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from sim.apriltag.detector import find_tags
from sim.files import write_arrays
from sim.recording.renderers import Part, UnsteadyError
from sim.robot.world import RoomWorld
from sim.rooms.build import build_room
from sim.sensors.camera_faults import decode, encode
from sim.sensors.camera_mount import drive_on
from sim.sensors.fisheye import Fisheye
from sim.sensors.lidar import Lidar
from sim.sensors.tag_camera import TagCamera
from sim.settings import SimSettings

DETECTIONS, TAG_CAMERA = ".tags.npz", ".tag_camera.npy"
"""Suffixes of the files next to an image file: the tag camera's detections at the same states, and its kept images."""
IMAGE, RENDERER, TWICE, DIFFERED = "image", "renderer", "drawn_twice", "differed"
"""Names of the arrays in a part's file."""
NONE_TWICE = {TWICE: np.array(0), DIFFERED: np.array(0)}
Beat = Callable[[], None]
"""Signals that the work continues."""


def _rest() -> None:
    pass


def sense_part(part: Part, beat: Beat) -> None:
    """Run in a worker: write those files of a part that do not exist yet.

    One image of a part is drawn again after the others to check that the renderer can be trusted. The part's file holds
    the name of the renderer (``renderer``), how many images were drawn twice and how often they differed.

    Raises:
        UnsteadyError: An image that was drawn twice came out different; nothing is written.
    """
    settings, path = part.settings, part.path
    if settings.tag_camera.mounted and not all(file.is_file() for file in side_files(settings, path)):

        def look_around(rows: slice) -> np.ndarray:
            return _look_around(settings, part.states[rows], beat)

        images, counts = _draw_twice(look_around, part)
        if settings.tag_camera.kept:
            write_arrays(path.with_suffix(TAG_CAMERA), {IMAGE: images})
        write_arrays(path.with_suffix(DETECTIONS), {**vars(find_tags(images)), **counts})
    if path.is_file():
        return
    if settings.sensor == "lidar":
        write_arrays(path, {IMAGE: _scan_states(settings, part.states, beat), RENDERER: np.array("none"), **NONE_TWICE})
        return

    def draw(rows: slice) -> np.ndarray:
        return draw_states(settings, part.states[rows], None if part.leans is None else part.leans[rows], beat)

    images, counts = _draw_twice(draw, part)
    renderer = open_camera(settings)[1].renderer_string  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    write_arrays(path, {IMAGE: images, RENDERER: np.array(renderer), **counts})


def side_files(settings: SimSettings, path: Path) -> list[Path]:
    """Files of the tag camera next to a part's file."""
    kept = [path.with_suffix(TAG_CAMERA)] if settings.tag_camera.kept else []
    return [path.with_suffix(DETECTIONS), *kept] if settings.tag_camera.mounted else []


def _draw_twice(draw: Callable[[slice], np.ndarray], part: Part) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """All images of a part, and how many were drawn twice and differed; raises UnsteadyError."""
    count = len(part.states)
    images = draw(slice(count))
    again = zlib.crc32(part.path.name.encode()) % max(count - 1, 1)  # not the last one, so that others come between
    if not np.array_equal(draw(slice(again, again + 1))[0], images[again]):
        raise UnsteadyError(f"{part.path}: image {again} of {count} was drawn twice and came out different")
    return images, {TWICE: np.array(1 + part.differed), DIFFERED: np.array(part.differed)}


def draw_states(
    settings: SimSettings, states: np.ndarray, leans: np.ndarray | None = None, beat: Beat = _rest
) -> np.ndarray:
    """Draw polar images (n, rings, sectors, 3) of states (n, nq), with the camera leaning by (n, 2) [rad].

    Runs in a worker; ``beat`` is called after each image.
    """
    world, fisheye = open_camera(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    images = np.empty((len(states), settings.camera.rings, settings.camera.sectors, 3), np.uint8)
    for number, (image, state) in enumerate(zip(images, states, strict=True)):
        lean = None if leans is None else leans[number]
        image[:] = _expose(world, fisheye, state, lean, settings.camera_mount.driven_m)
        beat()
    return images


def _expose(
    world: RoomWorld, fisheye: Fisheye, state: np.ndarray, lean: np.ndarray | None, driven_m: float
) -> np.ndarray:
    """Polar image of a state (nq,); if the robot drives during the exposure, the mean light of several images."""
    light = []
    for place in drive_on(state, driven_m) if driven_m else [state]:
        world.data.qpos[:] = place
        mujoco.mj_kinematics(world.model, world.data)
        light.append(fisheye.polar(world.data, lean))
    return encode(decode(np.array(light)).mean(axis=0)) if driven_m else light[0]


def _scan_states(settings: SimSettings, states: np.ndarray, beat: Beat) -> np.ndarray:
    """Noise-free scans (n, headings, rays) [m] of states (n, nq); runs in a worker."""
    lidar = _open_lidar(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    scans = []
    for state in states:
        scans.append(lidar.scan(state))
        beat()
    return np.stack(scans)


@lru_cache(maxsize=1)
def _open_lidar(settings: SimSettings) -> Lidar:
    """The lidar in its room, opened once per worker process."""
    return Lidar(build_room(settings.room), settings.lidar)


def _look_around(settings: SimSettings, states: np.ndarray, beat: Beat) -> np.ndarray:
    """Grey images (n, rows, columns) of the tag camera at states (n, nq); runs in a worker."""
    world, _ = open_camera(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    tag_camera = _open_tag_camera(settings)  # pyright: ignore[reportArgumentType]
    images = np.empty((len(states), settings.tag_camera.height_px, settings.tag_camera.width_px), np.uint8)
    for image, state in zip(images, states, strict=True):
        world.data.qpos[:] = state
        mujoco.mj_kinematics(world.model, world.data)
        image[:] = tag_camera.look(world.data)
        beat()
    return images


@lru_cache(maxsize=1)
def _open_tag_camera(settings: SimSettings) -> TagCamera:
    """The tag camera in the scene of ``open_camera``."""
    return TagCamera(open_camera(settings)[0].model, settings.tag_camera)  # pyright: ignore[reportArgumentType]


@lru_cache(maxsize=1)
def open_camera(settings: SimSettings) -> tuple[RoomWorld, Fisheye]:
    """The scene and its camera, opened once per worker process, since a context belongs to its process."""
    os.environ.setdefault("LP_NUM_THREADS", "0")  # no extra threads: the worker processes already share the cores
    world = RoomWorld(settings)
    return world, Fisheye(world.model, settings.camera)
