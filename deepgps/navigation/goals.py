"""Goals in a method's own frame, on floor that the robot has driven."""

import numpy as np

from deepgps.navigation.route import Floor
from sim.errors import InputError
from sim.rng import stream

MIN_WAY_M = 2.0  # Least way from one goal to the next [m]
MIN_EDGE_M = 0.12  # Least distance of a goal from the edge of the driven floor, where there is such a place [m]


def draw_goals(floor: Floor, seed: int, count: int) -> np.ndarray:
    """Goals (count, 2) [m], each at least ``MIN_WAY_M`` over the floor from the one before, or else the farthest.

    The first of more goals are those of fewer. Raises InputError if the floor has no place for a goal.
    """
    rng = stream(seed, "goals")
    cells = np.argwhere(floor.free & (floor.edge_m >= min(MIN_EDGE_M, floor.edge_m.max())))
    if not len(cells):
        raise InputError("the method's map has no floor that the robot has driven: it has no place for a goal")
    goals = [cells[rng.integers(len(cells))]]
    for _ in range(count):
        far = floor.ways(goals[-1])[0][tuple(cells.T)]
        far[~np.isfinite(far)] = 0.0
        apart = np.flatnonzero(far >= min(MIN_WAY_M, far.max()))
        goals.append(cells[apart[rng.integers(len(apart))]])
    return floor.places(np.array(goals[1:]).reshape(-1, 2))


def check_goal(floor: Floor, goal: np.ndarray, name: str) -> None:
    """Raise InputError, with a name for the goal (2,) [m], if it is not on the floor that the robot has driven."""
    if not np.isfinite(goal).all():
        raise InputError(f"{name}: a goal is two finite numbers, X and Y [m]")
    if floor.is_free(goal[None])[0]:
        return
    cells = floor.places(np.argwhere(floor.free))
    outside = ((goal < cells.min(axis=0)) | (goal > cells.max(axis=0))).any()
    where, away_m = "outside of" if outside else "within", np.linalg.norm(cells - goal, axis=1).min()
    raise InputError(
        f"{name}: {where} its map, but the robot has driven no floor there; the nearest is {away_m:.2f} m away"
    )
