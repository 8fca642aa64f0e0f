"""A small room for tests: four walls and a few boxes, made by hand and compiled in milliseconds."""

from collections.abc import Iterator

import mujoco
import numpy as np

from sim.robot.drive import Segment, next_segment
from sim.robot.explorer import make_planner
from sim.robot.headings import DriveMode
from sim.robot.motion import Robot
from sim.settings import DriveSettings

HALF_X, HALF_Y = 2.0, 1.5


def walls() -> mujoco.MjSpec:
    """A bare room of 4 m x 3 m."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(HALF_X, HALF_Y, 0.05))
    for name, x, y, half_x, half_y in (
        ("east", HALF_X + 0.1, 0, 0.1, HALF_Y + 0.2),
        ("west", -HALF_X - 0.1, 0, 0.1, HALF_Y + 0.2),
        ("north", 0, HALF_Y + 0.1, HALF_X, 0.1),
        ("south", 0, -HALF_Y - 0.1, HALF_X, 0.1),
    ):
        add_box(spec, name, (x, y, 1.0), (half_x, half_y, 1.0))
    return spec


def furnished() -> mujoco.MjSpec:
    """The same with a sofa, a table on legs and a pole."""
    spec = walls()
    add_box(spec, "sofa", (-1.4, -1.1, 0.4), (0.6, 0.4, 0.4))
    add_box(spec, "top", (0.8, 0.3, 0.7), (0.6, 0.4, 0.02))
    for name, x, y in (("a", 0.25, -0.05), ("b", 1.35, -0.05), ("c", 0.25, 0.65), ("d", 1.35, 0.65)):
        add_box(spec, f"leg_{name}", (x, y, 0.34), (0.02, 0.02, 0.34))
    add_box(spec, "pole", (-1.0, 0.8, 0.8), (0.015, 0.015, 0.8))
    return spec


def add_box(spec: mujoco.MjSpec, name: str, pos: tuple, half: tuple) -> None:
    """Add what collides and is not drawn, as rooms do."""
    spec.worldbody.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=pos, size=half, group=3, rgba=(0.5, 0.5, 0.5, 0.0)
    )


def drive(robot: Robot, settings: DriveSettings, rng: np.random.Generator) -> Iterator[Segment]:
    """Drive forever, one segment after another."""
    mode, planner = DriveMode(), make_planner(robot, settings)
    while True:
        segment = next_segment(robot, settings, rng, mode, planner)
        mode = segment.mode
        yield segment
