"""The fisheye camera as a sensor: images of the robot's states, with what is different in use."""

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from sim.errors import InputError
from sim.occupancy import FreeSpace
from sim.rooms.build import build_room
from sim.rooms.deployment import change_room
from sim.rooms.free_space import START, find_free_space
from sim.sensors.camera.faults import decode, encode
from sim.sensors.camera.fisheye import Dress, Fisheye
from sim.sensors.camera.illumination import KINDS, Illumination, Sources, expose, find_sources, hang_lamp, mix
from sim.sensors.camera.mount import drive_on
from sim.sensors.camera.visitors import (
    PERSON_HEIGHT_M,
    PERSON_RADIUS_M,
    add_shapes,
    draw_lamp,
    place_lamp,
    place_person,
)
from sim.sensors.catalog import Opened
from sim.settings import SimSettings

NEW_LAMP = "new lamp"
Relight = Callable[[np.ndarray, mujoco.MjData, np.ndarray | None, Dress], np.ndarray]
"""(linear light of an image, state, lean of the camera, what is added to the scene) -> its light in use."""


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
    """The room as it is in use, without the robot and the place where it starts, at which a person may not fit."""
    room = change_room(build_room(settings.room), settings.deployment)
    if (start := room.site(START)) is not None:
        room.delete(start)
    return room.compile()


def _find_floor(room: mujoco.MjModel) -> FreeSpace:
    """Where a person has room."""
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
