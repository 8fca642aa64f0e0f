"""Straight segments and turns in place, found from the wheels; arcs, rests and backward motion are neither.

Wheels that differ a little make a straight drive look like a slight curve. The usual curvature of the drive is
therefore taken off before a stretch is judged.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

import numpy as np

from deepgps.robot_io.logs.wheels import Wheels

Kind = Literal["straight", "turn", "rest", "arc", "back", "unknown"]
KINDS: tuple[Kind, ...] = get_args(Kind)
WINDOW_S = 0.1  # Speeds are measured over this much before and after [s]
REST_MPS = 0.005  # Speed of both rims up to which the robot rests [m/s]
DRIVING_MPS = 0.025  # Speed from which the usual curvature and the noise of turn rates are measured [m/s]
MAX_DEVIATIONS = 3.0  # Standard deviations of turn rates by which a straight drive may seem to turn
ARC_CURVATURE_PER_M = 0.25  # Curvature from which a drive is an arc [1/m]: a radius of 4 m
MIN_ARC_RATE_RADPS = 0.02  # Turn rate of a straight drive that is always allowed, for the encoders' resolution [rad/s]
MAX_USUAL_CURVATURE_PER_M = 0.15  # Largest curvature that is taken off as the usual one [1/m]
MAX_BEND_RAD = np.radians(8.0)  # Largest change of heading on a segment [rad]
JOIN_RAD = np.radians(1.0)  # Heading that may change where a segment speeds up or brakes, or rests in between [rad]
JOIN_M = 0.03  # Way of a motion that is too short to count, between two that do [m]
MIN_SEGMENT_M, MIN_BACK_M = 0.03, 0.015
"""Shortest segment and shortest way back [m]; what is shorter is an arc. Wheels that come to rest do not back off."""


@dataclass(frozen=True)
class Motion:
    """A part of the drive."""

    kind: Kind  # What the robot did
    first: int  # Number of the first message of the wheels in it
    last: int  # Number of the last one


@dataclass(frozen=True)
class Path:
    """How far the robot drove and turned by its wheels."""

    travelled_m: np.ndarray  # Distance at each message of the wheels (n,) [m]
    yaw: np.ndarray  # Heading at each (n,) [rad]

    def measure(self, motion: Motion) -> float:
        """Distance driven in a motion, forward or backward [m]."""
        return abs(float(self.travelled_m[motion.last] - self.travelled_m[motion.first]))

    def turn(self, motion: Motion) -> float:
        """Change of heading in a motion [rad]."""
        return float(self.yaw[motion.last] - self.yaw[motion.first])


class Driven(NamedTuple):
    """A drive by its wheels."""

    wheels: Wheels  # The wheels
    path: Path  # Distance and heading by them
    motions: list[Motion]  # What the robot did, in order; together, the motions cover the drive

    def sum_up(self, kind: str) -> dict[str, float]:
        """Number, duration and distance of the motions of a kind."""
        some, time_s = [one for one in self.motions if one.kind == kind], self.wheels.time_s
        seconds = sum(float(time_s[one.last] - time_s[one.first]) for one in some)
        metres = sum(map(self.path.measure, some))
        return {"count": len(some), "seconds": round(seconds, 1), "metres": round(metres, 2)}


def follow(wheels: Wheels, radius_m: float, track_m: float) -> Driven:
    """What a robot with wheels of this radius and track did [m]."""
    path = find_path(wheels.angle, radius_m, track_m)
    even = _take_off_usual(wheels, path)
    kind = _judge(wheels, even, track_m)
    edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    motions = [Motion(KINDS[kind[first]], first, last) for first, last in pairwise(edges)]
    motions = _leave_out_short(motions, "back", MIN_BACK_M, even)
    motions = [part for motion in _join(motions, even) for part in _divide_bent(motion, even)]
    return Driven(wheels, path, _leave_out_short(motions, "straight", MIN_SEGMENT_M, even))


def find_path(angle: np.ndarray, radius_m: float, track_m: float) -> Path:
    """Distance and heading by wheel angles (n, 2) [rad]: the wheels' mean, and their difference over the track."""
    rim = angle * radius_m
    return Path(rim.mean(axis=1), (rim[:, 1] - rim[:, 0]) / track_m)


def _take_off_usual(wheels: Wheels, path: Path) -> Path:
    """The path without the curvature that it usually has where the robot drives nearly straight."""
    speed, rate = _find_speeds(wheels, path)
    driving = (np.abs(speed) > DRIVING_MPS) & (np.abs(rate) < ARC_CURVATURE_PER_M * np.abs(speed))
    usual = float(np.median(rate[driving] / speed[driving])) if driving.any() else 0.0
    usual = float(np.clip(usual, -MAX_USUAL_CURVATURE_PER_M, MAX_USUAL_CURVATURE_PER_M))
    return Path(path.travelled_m, path.yaw - usual * path.travelled_m)


def _find_speeds(wheels: Wheels, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Speed [m/s] and turn rate [rad/s] in each interval (n - 1,), each over a window around it."""
    time_s, middle = wheels.time_s, (wheels.time_s[1:] + wheels.time_s[:-1]) / 2
    early, late = np.maximum(middle - WINDOW_S, time_s[0]), np.minimum(middle + WINDOW_S, time_s[-1])
    changes = [np.interp(late, time_s, one) - np.interp(early, time_s, one) for one in (path.travelled_m, path.yaw)]
    return changes[0] / (late - early), changes[1] / (late - early)


def _judge(wheels: Wheels, path: Path, track_m: float) -> np.ndarray:
    """Number of the kind in each interval (n - 1,)."""
    speed, rate = _find_speeds(wheels, path)
    noise, rim = _measure_noise(wheels.time_s, rate, speed), np.abs(rate) * track_m / 2
    kinds: dict[Kind, np.ndarray] = {
        "unknown": wheels.broken,
        "rest": (np.abs(speed) < REST_MPS) & (rim < REST_MPS),
        "turn": rim > 2 * np.abs(speed),
        "back": speed < 0,
        "arc": np.abs(rate) > ARC_CURVATURE_PER_M * np.abs(speed) + MIN_ARC_RATE_RADPS + MAX_DEVIATIONS * noise,
    }
    return np.select(list(kinds.values()), [KINDS.index(name) for name in kinds], KINDS.index("straight"))


def _measure_noise(time_s: np.ndarray, rate: np.ndarray, speed: np.ndarray) -> float:
    """Standard deviation of turn rates while the robot drives [rad/s], from rates that share no message of the wheels.

    A steady turn, as on an arc, has no part in it.
    """
    step = max(round(2 * WINDOW_S / float(np.median(np.diff(time_s)))) + 1, 1)
    driving = np.abs(speed) > DRIVING_MPS
    both = driving[step:] & driving[:-step]
    change = np.abs(rate[step:] - rate[:-step])[both]
    return float(1.4826 * np.median(change) / np.sqrt(2)) if len(change) else 0.0


def _divide_bent(motion: Motion, path: Path) -> list[Motion]:
    """A straight drive in pieces along each of which the heading changes little."""
    if motion.kind != "straight":
        return [motion]
    pieces, first = [], motion.first
    while first < motion.last:
        bent = np.abs(path.yaw[first : motion.last + 1] - path.yaw[first]) > MAX_BEND_RAD
        last = first + int(np.argmax(bent)) if bent.any() else motion.last
        pieces.append(Motion("straight", first, max(last, first + 1)))
        first = pieces[-1].last
    return pieces


def _join(motions: list[Motion], path: Path) -> list[Motion]:
    """Straight drives with the moments in which the robot speeds up, brakes or rests on the way."""
    while True:
        straight = [False, *(one.kind == "straight" for one in motions), False]
        joined: list[Motion] = []
        for one, before, after in zip(motions, straight, straight[2:], strict=False):
            slight = abs(path.turn(one)) < JOIN_RAD and path.measure(one) < JOIN_M
            beside = (before or after) if one.kind == "arc" else before and after and one.kind in {"rest", "turn"}
            kind: Kind = "straight" if slight and beside else one.kind
            first = joined.pop().first if joined and joined[-1].kind == kind else one.first
            joined.append(Motion(kind, first, one.last))
        if len(joined) == len(motions):
            return joined
        motions = joined


def _leave_out_short(motions: list[Motion], kind: Kind, least_m: float, path: Path) -> list[Motion]:
    """The motions with those of a kind that are shorter than ``least_m`` as arcs."""
    short = [one.kind == kind and path.measure(one) < least_m for one in motions]
    return [replace(one, kind="arc") if is_short else one for one, is_short in zip(motions, short, strict=True)]
