"""Motions of the robot between two poses in the plane, by its odometry, with their covariance."""

from dataclasses import dataclass

import numpy as np

from sim.errors import InputError
from sim.geometry import wrap

SCALE_STD, SCALE_DISTANCE_M = 0.02, 100.0
"""Standard deviation of the odometry's scale against the map's, and the way in which it changes [m]."""
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # Derivative of a rotation at zero


@dataclass(frozen=True)
class Motion:
    """How the robot moved from one pose to the next: it is carried by ``step`` and then turns."""

    step: np.ndarray  # Forward and to the left, in the frame of the robot before (2,) [m]
    turn: float  # Turn to the left [rad]
    covariance: np.ndarray  # Of forward, left and turn (3, 3) [m^2], [m rad], [rad^2]

    @property
    def length_m(self) -> float:
        """Distance between the two places [m]."""
        return float(np.hypot(*self.step))

    @property
    def expected_m(self) -> float:
        """Root of the expected square of the distance, which a motion of which little is known has too [m]."""
        return float(np.sqrt(self.step @ self.step + np.trace(self.covariance[:2, :2])))

    @property
    def expected_rad(self) -> float:
        """Root of the expected square of the turn [rad]."""
        return float(np.sqrt(self.turn**2 + self.covariance[2, 2]))


def make_motion(
    forward_m: float,
    left_m: float = 0.0,
    turn_rad: float = 0.0,
    step_std_m: float = 0.0,
    turn_std_rad: float = 0.0,
) -> Motion:
    """A motion ahead and to the left [m] with a turn to the left [rad], in the frame of the robot before.

    Its errors along both axes and of the turn are independent, with these standard deviations [m], [rad]. Raises
    InputError if a number is not finite, or a standard deviation is negative.
    """
    numbers = {"forward_m": forward_m, "left_m": left_m, "turn_rad": turn_rad}
    for name, value in numbers.items() | {"step_std_m": step_std_m, "turn_std_rad": turn_std_rad}.items():
        if not np.isfinite(value) or (value < 0.0 and name not in numbers):
            allowed = "finite" if name in numbers else "finite and not negative"
            raise InputError(f"{name} {value}: must be {allowed}; a motion of which nothing is known is None")
    spread = np.array([step_std_m, step_std_m, turn_std_rad])
    return Motion(np.array([forward_m, left_m]), float(turn_rad), np.diag(spread**2))


NO_MOTION = make_motion(0.0)  # No motion


def invert(motion: Motion) -> Motion:
    """The motion back: from the pose after to the pose before."""
    back = -rotate(np.array(-motion.turn)) @ motion.step
    change = np.zeros((3, 3))
    change[:2, :2] = -rotate(np.array(-motion.turn))
    change[:2, 2] = -QUARTER_TURN @ back
    change[2, 2] = -1.0
    return Motion(back, -motion.turn, change @ motion.covariance @ change.T)


def mirror(motion: Motion) -> Motion:
    """The motion in a map that is mirrored, where left is right."""
    sign = np.array([1.0, -1.0, -1.0])
    return Motion(motion.step * sign[:2], -motion.turn, motion.covariance * np.outer(sign, sign))


def rotate(angle: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 2, 2) by angles (...) [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)


def move(mean: np.ndarray, covariance: np.ndarray, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Poses with the scale of the odometry (K, 4) and their covariances (K, 4, 4) after a motion, linearised.

    The scale returns to 1 in ``SCALE_DISTANCE_M``, and its standard deviation to ``SCALE_STD``.
    """
    turned, kept = rotate(mean[:, 2]), np.exp(-motion.length_m / SCALE_DISTANCE_M)
    way = turned @ motion.step
    step = way * (1.0 + mean[:, 3:])
    moved = np.column_stack([mean[:, :2] + step, wrap(mean[:, 2] + motion.turn), mean[:, 3] * kept])
    change, noise = np.tile(np.eye(4), (len(mean), 1, 1)), np.tile(np.eye(4)[:, :3], (len(mean), 1, 1))
    change[:, :2, 2] = step @ QUARTER_TURN.T
    change[:, :2, 3] = way
    change[:, 3, 3] = kept
    noise[:, :2, :2] = turned
    grown = change @ covariance @ change.mT + noise @ motion.covariance @ noise.mT
    grown[:, 3, 3] += (1.0 - kept**2) * SCALE_STD**2
    return moved, grown


def compose(first: Motion, second: Motion) -> Motion:
    """One motion after another."""
    turned = rotate(np.array(first.turn))
    step = turned @ second.step
    change, own = np.eye(3), np.eye(3)
    change[:2, 2] = QUARTER_TURN @ step
    own[:2, :2] = turned
    covariance = change @ first.covariance @ change.T + own @ second.covariance @ own.T
    return Motion(first.step + step, first.turn + second.turn, covariance)
