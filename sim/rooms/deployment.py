"""What has changed in a room between training and use: its light, and where small pieces are."""

import mujoco
import numpy as np

from sim.errors import InputError
from sim.rng import stream
from sim.rooms.free_space import collides
from sim.rooms.spec import freeze
from sim.settings import DeploymentSettings

MOVABLE_KINDS = ("armchair", "barrel", "chair", "coat_stand", "coffee_table", "crates", "floor_lamp", "office_chair")
MOVABLE_KINDS += ("plant", "stool")
"""Pieces that a person would push aside."""
STEP_M = 0.05  # Spacing of collision checks along the path of a pushed piece [m]
TRIES = 24
GAMMA = 2.2  # Colours in the simulator are gamma-encoded: about the 2.2th root of light (IEC 61966-2-1)


def change_room(room: mujoco.MjSpec, deployment: DeploymentSettings) -> mujoco.MjSpec:
    """A copy of a room without anything that moves, with its furniture as it is in deployment."""
    still = freeze(room)
    return move_furniture(still, deployment.moved_m) if deployment.moved_m else still


def move_furniture(room: mujoco.MjSpec, moved_m: float, seed: int = 0) -> mujoco.MjSpec:
    """A copy of a room with each small piece pushed so far [m] in a random direction that is clear, if there is one.

    Raises InputError if no piece can be pushed that far, so nothing would change.
    """
    spec, rng = room.copy(), stream(seed, "moved furniture")
    model = spec.compile()
    solid = np.flatnonzero(collides(model) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE))
    pushed = 0
    for body in spec.bodies:
        if body.name.rpartition("_")[0] in MOVABLE_KINDS:
            angles = rng.uniform(-np.pi, np.pi, TRIES)  # as many for each piece, whichever it takes
            ways = moved_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            number = model.body(body.name).id
            way = next((way for way in ways if _is_clear(model, number, way, solid)), np.zeros(2))
            model.body_pos[number, :2] += way
            body.pos = model.body_pos[number]
            pushed += bool(way.any())
    if not pushed:
        raise InputError(f"deployment.moved_m {moved_m}: the room has no small piece that can be pushed so far")
    return spec


def dim(room: mujoco.MjSpec, deployment: DeploymentSettings) -> None:
    """Dim a scene's light, unless its sources are drawn apart and mixed later.

    A glowing material of one colour belongs to a lamp; one with a picture belongs to a window or a screen.
    """
    if deployment.draws_sources_apart:
        return
    windows, lamps = deployment.light ** (1.0 / GAMMA), (deployment.light * deployment.lamps) ** (1.0 / GAMMA)
    headlight = room.visual.headlight
    headlight.ambient = np.multiply(headlight.ambient, windows)
    for light in room.lights:
        light.diffuse = np.multiply(light.diffuse, lamps)
        light.ambient = np.multiply(light.ambient, lamps)
        light.specular = np.multiply(light.specular, lamps)
    for material in room.materials:
        material.emission *= windows if any(material.textures) else lamps


def _is_clear(model: mujoco.MjModel, body: int, way: np.ndarray, solid: np.ndarray) -> bool:
    """Whether a body can be pushed along a vector (2,) [m] without deeper contacts than it has where it is."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mine = model.geom_bodyid[solid] == body
    pairs = [(one, other) for one in solid[mine] for other in solid[~mine]]
    start = {pair: min(_distance(model, data, *pair), 0.0) for pair in pairs}
    places = {one: data.geom_xpos[one].copy() for one in solid[mine]}
    for step in np.linspace(0.0, 1.0, int(np.ceil(np.hypot(*way) / STEP_M)) + 1)[1:]:
        for one, place in places.items():
            data.geom_xpos[one, :2] = place[:2] + step * way
        if any(_distance(model, data, *pair) < touching for pair, touching in start.items()):
            return False
    return True


def _distance(model: mujoco.MjModel, data: mujoco.MjData, one: int, other: int) -> float:
    """Return the signed distance between two geoms [m], 0 if their bounding spheres do not meet."""
    apart = np.linalg.norm(data.geom_xpos[one] - data.geom_xpos[other])
    if apart > model.geom_rbound[one] + model.geom_rbound[other]:
        return 0.0
    return mujoco.mj_geomDistance(model, data, one, other, 0.0, None)
