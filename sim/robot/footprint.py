"""How far a robot reaches: the radius of the smallest cylinder around its axis, and its height, from its geoms."""

import mujoco
import numpy as np

DIRECTIONS = 720


def reach_of_geoms(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, float]:
    """How far the colliding geoms of a robot at the origin reach aside from its axis, and up [m].

    How far a convex body reaches in a direction d is the largest product of its points with d; how far it reaches
    aside is the largest of these over all level directions.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    level = np.stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)], axis=1)
    aside_m = up_m = 0.0
    for geom in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist():
        aside_m = max(aside_m, float(_support(model, data, geom, level).max()))
        up_m = max(up_m, float(_support(model, data, geom, np.array([[0.0, 0.0, 1.0]])).max()))
    return aside_m, up_m


def _support(model: mujoco.MjModel, data: mujoco.MjData, geom: int, direction: np.ndarray) -> np.ndarray:
    """How far a geom reaches in directions (n, 3) from the origin (n,) [m]."""
    along = direction @ data.geom_xmat[geom].reshape(3, 3)  # in the geom's own axes
    x, y, z = model.geom_size[geom]
    kind, across = model.geom_type[geom], np.hypot(along[:, 0], along[:, 1])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        reach = np.full(len(along), x)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        reach = x + y * np.abs(along[:, 2])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        reach = x * across + y * np.abs(along[:, 2])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        reach = np.linalg.norm(along * (x, y, z), axis=1)
    else:
        reach = np.abs(along) @ (x, y, z)
    return direction @ data.geom_xpos[geom] + reach
