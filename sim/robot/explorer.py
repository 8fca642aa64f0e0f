"""Planners that drive by the robot's own map: to the floor it has not been to, or to the nearest frontier.

One formula chooses the next segment: the new floor along it for the distance to its end and on to the nearest goal.
Goals are floor that no image is near, then floor that the fewest segments passed; for the rival, floor beside what is
not known. A goal that was aimed at in vain is left alone for a while.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from sim.geometry import wrap
from sim.robot.grid_map import CROSS, FLOOR_CELL_M, SWATH_M, Floor, GridMap, find_reached, go, scan
from sim.robot.headings import START_COST_M, STOP_DISTANCE_M, Course, DriveMode, Planner, Visits
from sim.robot.model import wheel_motion
from sim.robot.motion import Robot, look
from sim.robot.range_finder import REACH_M
from sim.robot.scan_match import match
from sim.settings import DriveSettings

SCAN_SPACING_M = 0.5  # Distance driven between two scans [m]
HEADINGS, HEADINGS_TRIED = 128, 12  # Headings compared on the map, and the best of these along which the robot looks
OFFSETS_RAD = np.radians((0.0, 1.0, -1.0, 2.0, -2.0))  # It also looks beside them, to get through an opening [rad]
CLEAR_SHARE = 0.6  # A heading is taken if this share of the length by the map is clear
START_RADIUS_M = 0.15  # Nearer than this, the floor is free whatever the map says [m]
MIN_LENGTH_M, MAX_LENGTH_M = 0.2, 5.0  # Shortest and longest segment that is aimed at [m]
GOAL_M = 0.3  # A goal is reached from this distance [m]
LEAST_PASSED_SHARE = 0.1  # Share of the floor that counts as passed by the fewest segments
SWATH_CELLS = round(2 * SWATH_M / FLOOR_CELL_M)
MOST_FAILED = 3  # After so many segments in a row without an image, any heading may be taken
MOST_AIMS, AIMS = 5, 60  # A goal that more than so many of the last aims were at is left alone
RIM_CELLS = 1, 4  # Floor this near to what was passed is likely seen, and surely not unseen
SMALLEST_PART_M2 = 0.05  # Smaller parts of the floor are not reported [m2]


class Explorer:
    """Goes to floor that no image is near, then to floor that the fewest segments passed."""

    goal_worth_m = 0.02  # A goal is worth as much as this length of new floor on the way to it [m]

    def __init__(self, robot: Robot) -> None:
        self._body, self._angle = robot.body, robot.wheel_angle()
        self._pose, self._grid, self._next_scan_m = np.zeros(3), GridMap(), 0.0
        self._imaged = self._pose  # Where the last image was taken
        self._failed, self._doubtful, self._aims = 0, False, np.empty((0, 2))
        self.unseen = np.ones(3)  # Share of the floor that no image is near: likely, at least, and at most

    def choose(self, robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: DriveMode) -> Course:
        """Where the next segment goes: along the best heading with enough that is clear by the rays."""
        self._scan(robot)
        floor, first_rad = self._grid.read_floor(self._body.radius_m), rng.uniform(-np.pi, np.pi)
        self.unseen = self.measure_unseen(floor)
        turned = first_rad + 2 * np.pi * np.arange(HEADINGS) / HEADINGS
        for goals in self._list_goals(floor) if self._failed < MOST_FAILED else ():
            value, end, length_m = self._compare(floor, goals, turned, min(settings.longest_m, MAX_LENGTH_M))
            for best in np.argsort(-value, kind="stable")[:HEADINGS_TRIED]:
                clear_m = max(CLEAR_SHARE * min(length_m[best], REACH_M), MIN_LENGTH_M) + STOP_DISTANCE_M
                for angle in turned[best] + OFFSETS_RAD if value[best] > 0.0 else ():
                    if look(robot, REACH_M, angle) >= clear_m:
                        goal = floor.places(goals)[np.hypot(*(floor.places(goals) - end[best]).T).argmin()]
                        self._aims = np.vstack([self._aims, goal])[-AIMS:]
                        return Course(wrap(float(angle)), length_m=float(length_m[best]))
        return Course(first_rad)

    def watch(self, robot: Robot, travelled_m: float) -> None:
        """Look around now and then, after ``travelled_m`` [m] of a segment."""
        if travelled_m == 0.0 and self._doubtful:
            self._scan(robot)
            self._doubtful = False
        elif travelled_m >= self._next_scan_m:
            self._grid.add(np.array((*go(self._pose, 0.0, travelled_m), self._pose[2])), scan(robot))
        elif travelled_m > 0.0:
            return
        self._next_scan_m = travelled_m + SCAN_SPACING_M

    def move(self, wheel_angle: np.ndarray) -> None:
        """Follow the robot to the wheel angles (2,) [rad], which it reached by a turn, a straight line or an arc."""
        arc_m, turned = wheel_motion(wheel_angle - self._angle, self._body)
        place = go(self._pose, turned / 2, arc_m * np.sinc(turned / (2 * np.pi)))
        self._pose, self._angle = np.array((*place, self._pose[2] + turned)), wheel_angle

    def pass_over(self, wheel_angle: np.ndarray, images: np.ndarray, touched: bool) -> None:
        """Follow the robot along a segment to the wheel angles (2,), with images at others (m, 2) [rad]."""
        if len(images) > 1:
            length_m, _ = wheel_motion(images[-1] - images[0], self._body)
            self._imaged = np.array((*go(self._pose, 0.0, length_m), self._pose[2]))
            self._grid.pass_over(self._pose[:2], self._imaged[:2])
        self.move(wheel_angle)
        if touched:
            self._grid.touch(self._pose, self._body.radius_m)
        self._failed, self._doubtful = 0 if len(images) > 1 else self._failed + 1, self._doubtful or touched

    def forget(self) -> None:
        """The robot was carried to its start, where its rays tell how it stands."""
        self._pose = np.zeros(3)

    def unreached(self, floor: Floor | None = None) -> np.ndarray:
        """Floor that the robot saw and where it fits, but did not get to: places and areas (n, 3) [m, m, m2]."""
        floor = floor or self._grid.read_floor(self._body.radius_m)
        stats, middle = cv2.connectedComponentsWithStats((floor.fits & (floor.passes == 0)).astype(np.uint8))[2:]
        area = stats[:, cv2.CC_STAT_AREA, None] * FLOOR_CELL_M**2
        parts = np.hstack([floor.corner_m + (middle + 0.5) * FLOOR_CELL_M, area])[1:]
        return parts[parts[:, 2] >= SMALLEST_PART_M2]

    def state(self) -> dict[str, np.ndarray]:
        """Arrays from which ``set_state`` restores everything."""
        own, grid = {"angle": self._angle, "pose": self._pose, "aims": self._aims}, self._grid
        own |= {"failed": np.array((self._failed, self._doubtful)), "box": np.stack([grid.low, grid.high])}
        own |= {"seen": grid.seen[grid.box], "passes": grid.passes[grid.box], "felt": grid.felt[grid.box]}
        return {f"map_{name}": part for name, part in own.items()} | {
            "unreached": self.unreached(floor := grid.read_floor(self._body.radius_m)),
            "unseen": self.unseen,
            **self._draw(floor),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore the arrays of ``state``; others are not read."""
        grid = self._grid
        grid.low, grid.high = state["map_box"]
        for name in ("seen", "passes", "felt"):
            getattr(grid, name)[grid.box] = state[f"map_{name}"]
        self._angle, self._pose, self._aims = (state[f"map_{name}"] for name in ("angle", "pose", "aims"))
        self._failed, self._doubtful = state["map_failed"].tolist()
        self.unseen, self._imaged = state["unseen"], state["view_pose"]

    def _scan(self, robot: Robot) -> None:
        seen = scan(robot)
        self._pose = match(self._grid, self._pose, seen, self._doubtful)
        self._grid.add(self._pose, seen)

    def _draw(self, floor: Floor) -> dict[str, np.ndarray]:
        """The map for people: cells that were passed 1, not yet 2, beside what is not known 3, where things stand 4."""
        code = np.where(floor.passes > 0, 1, np.where(floor.edge, 3, 2))
        view = np.where(floor.fits, code, np.where(self._grid.seen[self._grid.box][::2, ::2] > 0, 4, 0))
        at = np.array((*floor.corner_m, FLOOR_CELL_M))
        return {"view": view.astype(np.uint8), "view_at": at, "view_pose": self._imaged}

    def measure_unseen(self, floor: Floor | None = None) -> np.ndarray:
        """Share of the floor that no image is near: likely, at least, and at most (3,).

        Rims beside what was passed, and floor that was aimed at in vain, count only in the last, as does floor that is
        cut off by a front of touches.
        """
        floor = floor or self._grid.read_floor(self._body.radius_m)
        own, every = (find_reached(part, floor.been) for part in (floor.open & ~floor.shut, floor.open))
        passed = floor.passes > 0
        new = own & ~passed & ~self._is_left_alone(floor)
        near = [cv2.dilate(passed.astype(np.uint8), CROSS, iterations=cells) > 0 for cells in RIM_CELLS]
        likely, least = ((new & ~rim).sum() / max(own.sum(), 1) for rim in near)
        return np.array((likely, least, (every & ~passed).sum() / max(every.sum(), 1)))

    def _list_goals(self, floor: Floor) -> Iterator[np.ndarray]:
        """Masks of goals, the next if the robot finds no way to those before."""
        free = floor.fits & ~self._is_left_alone(floor)
        yield free & (floor.passes == 0)
        if (passed := free & (floor.passes > 0)).any():
            yield passed & (floor.passes <= np.quantile(floor.passes[passed], LEAST_PASSED_SHARE))

    def _is_left_alone(self, floor: Floor) -> np.ndarray:
        aims = np.zeros(floor.fits.shape)
        np.add.at(aims, floor.find(self._aims)[:2], 1.0)
        return _count_near(aims) > MOST_AIMS

    def _compare(
        self, floor: Floor, goals: np.ndarray, turned: np.ndarray, longest_m: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For headings (n,) to the left of ahead [rad]: what the best segment is worth, its end (n, 2), its length."""
        along = np.arange(FLOOR_CELL_M, longest_m + 1e-9, FLOOR_CELL_M)
        place = go(self._pose, turned[:, None], along)
        row, column, inside = floor.find(place)
        clear = np.logical_and.accumulate(inside & (floor.fits[row, column] | (along < START_RADIUS_M)), axis=1)
        new_m = _count_near(goals)[row, column].cumsum(axis=1) * (FLOOR_CELL_M / SWATH_CELLS**2)
        rest_m = floor.way(goals)[row, column]
        cost_m = START_COST_M * (1.0 + (rest_m > GOAL_M)) + along + rest_m
        value = np.where(clear & (along >= MIN_LENGTH_M), (self.goal_worth_m + new_m) / cost_m, 0.0)
        best = np.arange(len(turned)), value.argmax(axis=1)
        return value[best], place[best], along[best[1]]


class NearestFrontier(Explorer):
    """Goes to the nearest floor beside what is not known yet, else anywhere."""

    goal_worth_m = 1e6

    def _list_goals(self, floor: Floor) -> Iterator[np.ndarray]:
        yield floor.fits & floor.edge & (floor.passes == 0) & ~self._is_left_alone(floor)


def make_planner(robot: Robot, settings: DriveSettings) -> Planner:
    """The planner that the settings name, for a robot where it starts."""
    planner = {"map": Explorer, "frontier": NearestFrontier}.get(settings.headings)
    return planner(robot) if planner else Visits(robot.body, robot.wheel_angle())


def _count_near(marks: np.ndarray) -> np.ndarray:
    """Number of marks in a square of SWATH_CELLS about each cell."""
    size = (SWATH_CELLS, SWATH_CELLS)
    return cv2.boxFilter(marks.astype(np.float32), -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
