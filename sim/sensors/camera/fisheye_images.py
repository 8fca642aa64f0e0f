"""The fisheye camera as a sensor: images of the robot's states, with what is different in deployment.

A person, and a lamp that was switched on, are drawn only; physics knows neither of them.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import mujoco
import numpy as np

from sim.errors import InputError
from sim.geometry import FreeSpace, planar_pose
from sim.rng import stream
from sim.rooms.build import build_room
from sim.rooms.deployment import change_room
from sim.rooms.free_space import START, find_free_space
from sim.sensors.camera.faults import FACE_PX, RAW_TITLES, add_glare, compress, decode, encode
from sim.sensors.camera.fisheye import Dress, Fisheye
from sim.sensors.camera.illumination import KINDS, Sources, expose, find_sources, hang_lamp, mix, open_illumination
from sim.sensors.camera.mount import CIRCLE_PX, drive_on
from sim.sensors.camera.unwrap import RoundImage, draw_polar
from sim.sensors.catalog import Opened
from sim.settings import SimSettings

PERSON_RADIUS_M, PERSON_HEIGHT_M = 0.25, 1.75
MIN_DISTANCE_M = 0.5
"""A person's middle is at least this far from the camera [m]: more than the person's radius and the robot's."""
WALK_M_PER_RAD, LEG_RAD = 0.15, 60.0
"""Way that a person walks while the wheels turn by a radian [m], 1 m/s to the robot's 0.22; and angle that the wheels
turn from one person's start to the next, which includes standing [rad]."""
STEP_M, TRIES = 0.01, 64  # Spacing of the points of a way [m], and how many ends of it are tried
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


class Persons:
    """Persons in a room, who stand about in a still scene, and walk and stand during a drive.

    Where they are depends on the seed and the robot's state alone, not on which other images are taken. On a drive,
    the mean angle of the wheels is the clock by which they walk: they wait while the robot turns in place.
    """

    def __init__(self, space: FreeSpace, count: int, seed: int = 0) -> None:
        """Find places for so many persons in the space where one has room."""
        self._places = space.places()
        self._space, self._count, self._seed = space, count, seed
        self._rng = [stream(seed, "walk", number) for number in range(count)]
        self._stops = [[self._places[rng.integers(len(self._places))]] for rng in self._rng]

    def draw(self, state: np.ndarray) -> list[Shape]:
        """The persons in view of the robot in a state (nq,); none is close to it.

        A robot whose wheels have not turned was put there: each person stands at a random free place.
        """
        robot, clock = planar_pose(state)[:2], abs(float(state[7:].mean()))
        if not clock:
            return self._place(state, robot)
        return [part for number in range(self._count) for part in self._walk(number, clock, robot)]

    def _place(self, state: np.ndarray, robot: np.ndarray) -> list[Shape]:
        rng = stream(self._seed, "person", zlib.crc32(np.ascontiguousarray(state).tobytes()))
        places = self._places[_is_apart(self._places, robot)]
        chosen = range(self._count if len(places) else 0)
        return [part for _ in chosen for part in _draw_person(places[rng.integers(len(places))], rng)]

    def _walk(self, number: int, clock: float, robot: np.ndarray) -> list[Shape]:
        """A person on the way from one stop to the next, or at that; in the robot's way, at the nearest place that is
        not."""
        stops, leg = self._stops[number], int(clock // LEG_RAD)
        while len(stops) < leg + 2:
            stops.append(self._choose_stop(stops[-1], self._rng[number]))
        way = _lay_way(*stops[leg : leg + 2])
        length = np.linalg.norm(way[-1] - way[0])
        walked = min(clock % LEG_RAD * WALK_M_PER_RAD / max(length, 1e-9), 1.0) * (len(way) - 1)
        off = np.where(_is_apart(way, robot), np.abs(np.arange(len(way)) - walked), np.inf)
        if np.isinf(off.min()):
            return []
        along = way[-1] - way[0]
        looks = stream(self._seed, "person in a drive", number)
        return _draw_person(way[off.argmin()], looks, float(np.arctan2(along[1], along[0])))

    def _choose_stop(self, start: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A random free place straight ahead of which nothing stands; the start if none is found."""
        ends = self._places[rng.integers(len(self._places), size=TRIES)]
        return next((end for end in ends if self._space.is_reachable(_lay_way(start, end)).all()), start)


def _lay_way(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points (n, 2) [m] along a straight way, of which neighbours are at most ``STEP_M`` apart."""
    count = int(np.ceil(np.linalg.norm(end - start) / STEP_M)) + 1
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)


def _is_apart(places: np.ndarray, robot: np.ndarray) -> np.ndarray:
    return np.linalg.norm(places - robot, axis=1) > MIN_DISTANCE_M


def place_lamp(space: FreeSpace, room: mujoco.MjModel, seed: int = 0) -> np.ndarray:
    """Place (3,) [m] of a lamp above a random place where a person has room, below the ceiling if the room has one."""
    places = space.places()
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


def _draw_person(place: np.ndarray, rng: np.random.Generator, heading: float | None = None) -> list[Shape]:
    """A person of random size, in random clothes, turned at random unless a heading is given [rad]: legs, hips, trunk,
    arms, head."""
    tall, yaw = rng.uniform(0.88, 1.0) * PERSON_HEIGHT_M, rng.uniform(-np.pi, np.pi)
    yaw = yaw if heading is None else heading
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
    model, driven_m, faults = scene(), settings.camera_mount.driven_m, settings.image_faults
    look: Callable = Fisheye.polar
    shape, middle = (settings.camera.rings, settings.camera.sectors), (CIRCLE_PX - 1) / 2
    points = RoundImage((middle, middle), CIRCLE_PX / 2).find_points(*shape)
    if raw := any(getattr(faults, name) for name in RAW_TITLES):
        look, face_px = partial(Fisheye.round, size_px=CIRCLE_PX), max(settings.camera.face_px, FACE_PX)
        settings = settings.model_copy(update={"camera": settings.camera.model_copy(update={"face_px": face_px})})
    camera, data = Fisheye(model, settings.camera, settings.camera_mount), mujoco.MjData(model)
    room = _build_empty(settings) if settings.deployment.person or settings.deployment.lamp_on else None
    space = _find_floor(room) if room else None
    lamp = place_lamp(space, room) if space and room and settings.deployment.lamp_on else None
    relight = _open_relight(settings, model, lamp, look)
    persons = Persons(space, settings.deployment.person) if space else None

    def sense(state: np.ndarray, lean: np.ndarray | None) -> np.ndarray:
        shapes = [] if lamp is None else draw_lamp(lamp)
        shapes += persons.draw(state) if persons else []
        dress, light = partial(add_shapes, shapes=shapes), []
        for place in drive_on(state, driven_m) if driven_m else [state]:
            data.qpos[:] = place
            mujoco.mj_kinematics(model, data)
            seen = decode(look(camera, data, lean=lean, dress=dress))
            light.append(relight(seen, data, lean, dress) if relight else seen)
        mean = np.array(light).mean(axis=0)
        if faults.glare:
            mean = add_glare(mean, faults.glare, CIRCLE_PX / settings.camera.field_of_view_deg)
        image = encode(expose(mean) if settings.deployment.exposure == "auto" else mean)
        if faults.jpeg_kb:
            image = np.asarray(cv2.imdecode(compress(image, faults.jpeg_kb), cv2.IMREAD_COLOR))[..., ::-1]
        return draw_polar(image, points, *shape) if raw else image

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
            f"a person and deployment.lamp_on need floor for a person, {2 * PERSON_RADIUS_M:g} m wide: {error}"
        ) from None


def _open_relight(
    settings: SimSettings, model: mujoco.MjModel, lamp: np.ndarray | None, look: Callable
) -> Relight | None:
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
    draw = open_illumination(model, settings.camera, settings.camera_mount, sources, look)
    return lambda light, data, lean, dress: mix(light, draw(data, lean, dress), fraction)
