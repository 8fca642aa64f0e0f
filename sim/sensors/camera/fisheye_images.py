"""The fisheye camera as a sensor: images of the robot's states, with what is different in deployment.

A person, and a lamp that was switched on, are drawn only; physics knows neither of them.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from sim.errors import InputError
from sim.geometry import FreeSpace, planar_pose
from sim.rng import stream
from sim.rooms.build import build_room
from sim.rooms.deployment import change_room
from sim.rooms.free_space import START, find_free_space
from sim.sensors.camera.faults import decode, encode
from sim.sensors.camera.fisheye import Dress, Fisheye
from sim.sensors.camera.illumination import KINDS, Illumination, Sources, expose, find_sources, hang_lamp, mix
from sim.sensors.camera.mount import drive_on
from sim.sensors.catalog import Opened
from sim.settings import SimSettings

PERSON_RADIUS_M, PERSON_HEIGHT_M = 0.25, 1.75
MIN_DISTANCE_M = 0.5
"""A person's middle is at least this far from the camera [m]: more than the person's radius and the robot's."""
MAX_LAMP_HEIGHT_M, LAMP_RADIUS_M = 2.0, 0.08  # Largest height of a lamp above the floor, and its radius [m]
CEILING_GAP_M = 0.1  # How far a lamp's middle is below what is above it [m]
SKIN_COLOURS = ((0.96, 0.8, 0.69), (0.78, 0.57, 0.44), (0.45, 0.3, 0.22))


@dataclass(frozen=True)
class Shape:
    """A shape to draw."""

    kind: mujoco.mjtGeom  # Its geometry
    size: tuple[float, float, float]  # As of a geom of this kind (3,) [m]
    place: np.ndarray  # Its middle (3,) [m]
    turn: np.ndarray  # Its axes as columns (3, 3)
    colour: tuple[float, float, float]  # Red, green, blue
    glow: float = 0.0  # Fraction of the colour that it emits


def add_shapes(scene: mujoco.MjvScene, shapes: list[Shape]) -> None:
    """Add shapes to a scene."""
    for shape in shapes:
        geom = scene.geoms[scene.ngeom]
        colour = np.array([*shape.colour, 1.0], np.float32)
        mujoco.mjv_initGeom(geom, shape.kind, np.array(shape.size), shape.place, shape.turn.ravel(), colour)
        geom.emission, geom.specular, geom.shininess = shape.glow, 0.0, 0.0
        scene.ngeom += 1


def place_person(space: FreeSpace, state: np.ndarray, seed: int = 0) -> list[Shape]:
    """A person at a random free place, for the state (nq,) in which an image is taken; none if no place is free.

    The draw depends on the seed and on the state alone, not on which other images are taken.
    """
    rng = stream(seed, "person", zlib.crc32(np.ascontiguousarray(state).tobytes()))
    places = _list_free(space)
    places = places[np.linalg.norm(places - planar_pose(state)[:2], axis=1) > MIN_DISTANCE_M]
    return _draw_person(places[rng.integers(len(places))], rng) if len(places) else []


def place_lamp(space: FreeSpace, room: mujoco.MjModel, seed: int = 0) -> np.ndarray:
    """Place (3,) [m] of a lamp above a random place where a person has room, below the ceiling if the room has one."""
    places = _list_free(space)
    place = np.array([*places[stream(seed, "lamp").integers(len(places))], PERSON_HEIGHT_M / 2])
    data = mujoco.MjData(room)
    mujoco.mj_kinematics(room, data)
    above = mujoco.mj_ray(room, data, place, np.array([0.0, 0.0, 1.0]), None, 1, -1, np.zeros(1, np.int32))
    place[2] = MAX_LAMP_HEIGHT_M if above < 0 else min(MAX_LAMP_HEIGHT_M, place[2] + above - CEILING_GAP_M)
    return place


def draw_lamp(place: np.ndarray) -> list[Shape]:
    """A glowing lamp at a place (3,) [m]."""
    size = (LAMP_RADIUS_M, LAMP_RADIUS_M, LAMP_RADIUS_M)
    return [Shape(mujoco.mjtGeom.mjGEOM_SPHERE, size, place, np.eye(3), (1.0, 1.0, 1.0), 1.0)]


def _list_free(space: FreeSpace) -> np.ndarray:
    """Middles (n, 2) [m] of the free cells that can be reached."""
    row, column = np.nonzero(space.reachable)
    return space.origin + space.cell_m * np.stack([column, row], axis=1)


def _draw_person(place: np.ndarray, rng: np.random.Generator) -> list[Shape]:
    """A standing person of random size, in random clothes, turned at random: legs, hips, trunk, arms, head."""
    tall, yaw = rng.uniform(0.88, 1.0) * PERSON_HEIGHT_M, rng.uniform(-np.pi, np.pi)
    trousers, shirt = (tuple(rng.uniform(0.05, 0.9, 3).tolist()) for _ in range(2))
    skin = SKIN_COLOURS[rng.integers(len(SKIN_COLOURS))]
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    ellipsoid, capsule = mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE
    parts = [  # ahead, aside and height of the middle, as parts of the height
        *((capsule, (0.045, 0.045, 0.2), (0.0, side, 0.245), trousers) for side in (-0.055, 0.055)),
        (ellipsoid, (0.07, 0.095, 0.1), (0.0, 0.0, 0.45), trousers),
        (ellipsoid, (0.075, 0.11, 0.24), (0.0, 0.0, 0.63), shirt),
        *((capsule, (0.028, 0.028, 0.14), (0.0, side, 0.63), shirt) for side in (-0.125, 0.125)),
        (ellipsoid, (0.06, 0.048, 0.075), (0.0, 0.0, 0.925), skin),
    ]
    return [
        Shape(kind, tuple(tall * np.array(size)), np.array([*place, 0.0]) + turn @ np.array(at) * tall, turn, colour)
        for kind, size, at, colour in parts
    ]


NEW_LAMP = "new lamp"
Relight = Callable[[np.ndarray, mujoco.MjData, np.ndarray | None, Dress], np.ndarray]
"""(linear light of an image, state, lean of the camera, what is added to the scene) -> its light in deployment."""


def open_fisheye(settings: SimSettings, scene: Callable[[], mujoco.MjModel]) -> Opened:
    """Open the camera in the scene; if the robot drives during the exposure, an image is the mean light of several."""
    model, driven_m = scene(), settings.camera_mount.driven_m
    camera, data = Fisheye(model, settings.camera, settings.camera_mount), mujoco.MjData(model)
    room = _build_empty(settings) if settings.deployment.person or settings.deployment.lamp_on else None
    space = _find_floor(room) if room else None
    lamp = place_lamp(space, room) if space and room and settings.deployment.lamp_on else None
    relight = _open_relight(settings, model, lamp)

    def sense(state: np.ndarray, lean: np.ndarray | None) -> np.ndarray:
        shapes = [] if lamp is None else draw_lamp(lamp)
        if space and settings.deployment.person:
            shapes += place_person(space, state)
        dress, light = partial(add_shapes, shapes=shapes), []
        for place in drive_on(state, driven_m) if driven_m else [state]:
            data.qpos[:] = place
            mujoco.mj_kinematics(model, data)
            seen = decode(camera.polar(data, lean, dress))
            light.append(relight(seen, data, lean, dress) if relight else seen)
        mean = np.array(light).mean(axis=0)
        return encode(expose(mean) if settings.deployment.exposure == "auto" else mean)

    return Opened(sense, camera.renderer_string)


def _build_empty(settings: SimSettings) -> mujoco.MjModel:
    """The room as it is in deployment, without the robot and the place where it starts, where a person may not fit."""
    room = change_room(build_room(settings.room), settings.deployment)
    if (start := room.site(START)) is not None:
        room.delete(start)
    return room.compile()


def _find_floor(room: mujoco.MjModel) -> FreeSpace:
    try:
        return find_free_space(room, PERSON_RADIUS_M, PERSON_HEIGHT_M)
    except InputError as error:
        raise InputError(
            f"deployment.person and deployment.lamp_on need floor for a person, {2 * PERSON_RADIUS_M:g} m wide: {error}"
        ) from None


def _open_relight(settings: SimSettings, model: mujoco.MjModel, lamp: np.ndarray | None) -> Relight | None:
    """Open what mixes the light of lamps, windows and a lamp that is on (3,) [m]; None: the light is as drawn."""
    deployment = settings.deployment
    if not deployment.draws_sources_apart:
        return None
    sources: dict[str, Sources] = {kind: find_sources(model, kind) for kind in KINDS}
    if deployment.daylight is not None and not len(sources["windows"].geoms):
        raise InputError("the room has no window, and deployment.daylight and drive.mixed_light need one")
    daylight = 1.0 if deployment.daylight is None else deployment.daylight
    fraction = {"lamps": deployment.light * deployment.lamps, "windows": deployment.light * daylight}
    if lamp is not None:
        sources[NEW_LAMP], fraction[NEW_LAMP] = hang_lamp(lamp), deployment.light
    illumination = Illumination(model, settings.camera, settings.camera_mount, sources)
    return lambda light, data, lean, dress: mix(light, illumination.draw(data, lean, dress), fraction)
