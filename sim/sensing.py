"""What the sensors make of states of the robot, in worker processes: each opens its cameras once and keeps them."""

import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sim.camera_faults import decode, encode
from sim.files import write_array, write_arrays
from sim.horizontal import Horizontal
from sim.lidar import Lidar
from sim.mount import drive_on
from sim.render import Fisheye
from sim.room import build_room
from sim.settings import SensorName, SimSettings
from sim.tags import find_tags
from sim.world import RoomWorld

SIGHTINGS, HORIZONTAL = ".tags.npz", ".horizontal.npy"
"""Beside an image file: tags that the horizontal camera saw from the same states, and its images, if they are kept."""


def sense_states(settings: SimSettings, states: np.ndarray, path: Path, leans: np.ndarray | None = None) -> str:
    """In a worker: write what is seen in states (n, nq) to ``path``, if it does not stand; name the renderer.

    Args:
        settings: The room, as it is now, and the sensor.
        states: Full positions of the simulation.
        path: The file.
        leans: Of the camera at each state (n, 2) [rad]; none: it stands upright.
    """
    if settings.horizontal.mounted and not path.with_suffix(SIGHTINGS).is_file():
        images = _look_around(settings, states)
        if settings.horizontal.kept:
            write_array(path.with_suffix(HORIZONTAL), images)
        write_arrays(path.with_suffix(SIGHTINGS), vars(find_tags(images)))
    if not path.is_file():
        write_array(path, SEE[settings.sensor](settings, states, leans))
    if settings.sensor == "lidar":
        return "none"
    return open_camera(settings)[1].renderer_string  # pyright: ignore[reportArgumentType] (frozen settings do hash)


def draw_states(settings: SimSettings, states: np.ndarray, leans: np.ndarray | None = None) -> np.ndarray:
    """In a worker: polar images (n, rings, sectors, 3) of states (n, nq), the camera leaning by (n, 2) [rad]."""
    world, fisheye = open_camera(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    images = np.empty((len(states), settings.camera.rings, settings.camera.sectors, 3), np.uint8)
    for number, (image, state) in enumerate(zip(images, states, strict=True)):
        lean = None if leans is None else leans[number]
        image[:] = _expose(world, fisheye, state, lean, settings.mount.driven_m)
    return images


def _expose(
    world: RoomWorld, fisheye: Fisheye, state: np.ndarray, lean: np.ndarray | None, driven_m: float
) -> np.ndarray:
    """One polar image of a state (nq,), or where the robot drives meanwhile the mean light of several."""
    light = []
    for place in drive_on(state, driven_m) if driven_m else [state]:
        world.data.qpos[:] = place
        mujoco.mj_kinematics(world.model, world.data)
        light.append(fisheye.polar(world.data, lean))
    return encode(decode(np.array(light)).mean(axis=0)) if driven_m else light[0]


def _scan_states(settings: SimSettings, states: np.ndarray, leans: None = None) -> np.ndarray:
    """In a worker: scans (n, headings, rays) [m] of states (n, nq), exact."""
    lidar = _open_lidar(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    return np.stack([lidar.scan(state) for state in states])


SEE: dict[SensorName, Callable[[SimSettings, np.ndarray, Any], np.ndarray]] = {
    "fisheye": draw_states,
    "lidar": _scan_states,
}


@lru_cache(maxsize=1)
def _open_lidar(settings: SimSettings) -> Lidar:
    """The lidar in its room, opened once in each worker."""
    return Lidar(build_room(settings.room), settings.lidar)


def _look_around(settings: SimSettings, states: np.ndarray) -> np.ndarray:
    """In a worker: grey images (n, rows, columns) of the horizontal camera at states (n, nq)."""
    world, _ = open_camera(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    horizontal = _open_horizontal(settings)  # pyright: ignore[reportArgumentType]
    images = np.empty((len(states), settings.horizontal.height_px, settings.horizontal.width_px), np.uint8)
    for image, state in zip(images, states, strict=True):
        world.data.qpos[:] = state
        mujoco.mj_kinematics(world.model, world.data)
        image[:] = horizontal.look(world.data)
    return images


@lru_cache(maxsize=1)
def _open_horizontal(settings: SimSettings) -> Horizontal:
    """The horizontal camera of the scene of ``open_camera``."""
    return Horizontal(open_camera(settings)[0].model, settings.horizontal)  # pyright: ignore[reportArgumentType]


@lru_cache(maxsize=1)
def open_camera(settings: SimSettings) -> tuple[RoomWorld, Fisheye]:
    """The scene and its camera, opened once in each worker: a context belongs to its process."""
    os.environ.setdefault("LP_NUM_THREADS", "0")  # none but this: the workers share the cores already
    world = RoomWorld(settings)
    return world, Fisheye(world.model, settings.camera)
