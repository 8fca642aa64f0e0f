"""The follower: pure pursuit of a route.

R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992.
"""

from typing import NamedTuple

import numpy as np

from deepgps.navigation.route import measure_along
from sim.geometry import wrap

AHEAD_M = 0.1, 0.25  # Least and largest distance along the route at which the robot aims [m]
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
    """Follows a route (n, 2) [m] over floor that ends so far from each point (n,) [m]; where that is near, it aims nearer."""

    def __init__(self, route: np.ndarray, edge_m: np.ndarray) -> None:
        self.route, self.along, self._ahead_m = route, measure_along(route), np.clip(edge_m, *AHEAD_M)
        self.travelled_m, self._speed = 0.0, 0.0

    @property
    def speed(self) -> float:
        """The speed that was last commanded [m/s]."""
        return self._speed

    def aim(self, place: np.ndarray) -> np.ndarray:
        """The point (2,) of the route to aim at from a place (2,) [m]; never back along the route."""
        near = (self.along >= self.travelled_m) & (self.along <= self.travelled_m + WINDOW_M)
        apart = np.where(near, np.linalg.norm(self.route - place, axis=1), np.inf)
        nearest = int(apart.argmin())
        self.travelled_m = float(self.along[nearest])
        at = min(self.travelled_m + float(self._ahead_m[nearest]), float(self.along[-1]))
        return np.array([np.interp(at, self.along, part) for part in self.route.T])

    def step(self, pose: np.ndarray, clear_m: float, period_s: float) -> Command:
        """What to do for a period [s] at a pose (3,), if so much is clear ahead of the robot [m]."""
        away = self.aim(pose[:2]) - pose[:2]
        angle, distance_m = float(wrap(np.arctan2(away[1], away[0]) - pose[2])), float(np.hypot(*away))
        rest_m = float(np.linalg.norm(self.route[-1] - pose[:2]))
        braking = float(np.sqrt(2.0 * ACCELERATION_MPS2 * max(min(rest_m, clear_m), 0.0)))
        if abs(angle) > (PIVOT_RAD if clear_m > AHEAD_M[1] or self._speed > 0.0 else AIM_RAD):
            self._speed = min(max(0.0, self._speed - ACCELERATION_MPS2 * period_s), braking)
            return Command(self._speed, float(np.clip(PIVOT_GAIN_PER_S * angle, -MAX_TURN_RPS, MAX_TURN_RPS)))
        curvature = 2.0 * np.sin(angle) / max(distance_m, 0.05)
        highest = min(MAX_SPEED_MPS, MAX_TURN_RPS / max(abs(curvature), 1e-9))
        self._speed = float(min(highest, self._speed + ACCELERATION_MPS2 * period_s, braking))
        return Command(self._speed, float(np.clip(self._speed * curvature, -MAX_TURN_RPS, MAX_TURN_RPS)))
