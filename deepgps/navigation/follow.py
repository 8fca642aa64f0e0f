"""The follower: pure pursuit of a route.

R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992.
"""

from typing import NamedTuple

import numpy as np

from deepgps.navigation.route import measure_along
from sim.geometry import wrap

LOOKAHEAD_M = 0.1, 0.25  # Least and largest distance along the route at which the robot aims [m]
MAX_SPEED_MPS, MAX_TURN_RPS = 0.22, 1.2  # Largest speed [m/s] and turn rate [rad/s]
ACCELERATION_MPS2 = 0.4  # Largest acceleration and braking [m/s^2]
PIVOT_RAD, PIVOT_GAIN_PER_S = 0.8, 4.0  # Aims beyond this angle are turned to in place [rad]; turn rate over the angle
AIM_RAD = 0.1  # A robot at rest before something aims as well as this before it drives [rad]
WINDOW_M = 0.5  # Length of the route, from where the robot was last, in which it looks for where it is [m]


class Command(NamedTuple):
    """Speed [m/s] and turn rate to the left [rad/s] for the next period."""

    speed_mps: float
    turn_rps: float


REST = Command(0.0, 0.0)


class Follower:
    """Follows a route (n, 2) [m]; where the floor ends near it, ``edge_m`` (n,) away, it aims nearer."""

    def __init__(self, route: np.ndarray, edge_m: np.ndarray) -> None:
        self.route, self.along, self._ahead_m = route, measure_along(route), np.clip(edge_m, *LOOKAHEAD_M)
        self._passed_m = self._away_m = self._speed = 0.0

    def aim(self, pose: np.ndarray) -> float:
        """Angle [rad] from the heading of a pose (3,) to the point of the route to aim at, which never goes back."""
        near = (self.along >= self._passed_m) & (self.along <= self._passed_m + WINDOW_M)
        nearest = int(np.where(near, np.linalg.norm(self.route - pose[:2], axis=1), np.inf).argmin())
        self._passed_m = float(self.along[nearest])
        at = min(self._passed_m + float(self._ahead_m[nearest]), float(self.along[-1]))
        away = np.array([np.interp(at, self.along, part) for part in self.route.T]) - pose[:2]
        self._away_m = float(np.hypot(*away))
        return float(wrap(np.arctan2(away[1], away[0]) - pose[2]))

    def step(self, pose: np.ndarray, free_m: float, period_s: float) -> Command:
        """What to do for a period [s] at a pose (3,), if so much is free before the robot [m]."""
        angle, rest_m = self.aim(pose), float(np.linalg.norm(self.route[-1] - pose[:2]))
        braking = float(np.sqrt(2.0 * ACCELERATION_MPS2 * max(min(rest_m, free_m), 0.0)))
        if abs(angle) > (PIVOT_RAD if free_m > LOOKAHEAD_M[1] or self._speed > 0.0 else AIM_RAD):
            self._speed = min(max(0.0, self._speed - ACCELERATION_MPS2 * period_s), braking)
            return Command(self._speed, float(np.clip(PIVOT_GAIN_PER_S * angle, -MAX_TURN_RPS, MAX_TURN_RPS)))
        curvature = 2.0 * np.sin(angle) / max(self._away_m, 0.05)
        highest = min(MAX_SPEED_MPS, MAX_TURN_RPS / max(abs(curvature), 1e-9))
        self._speed = float(min(highest, self._speed + ACCELERATION_MPS2 * period_s, braking))
        return Command(self._speed, self._speed * curvature)
