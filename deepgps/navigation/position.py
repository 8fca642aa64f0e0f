"""Where the robot is, as its controller takes it: tracked by images and wheels, by wheels alone, or given.

All poses are in the method's own frame. Where that is mirrored, a turn to the left is one to the right in it (``hand``).
"""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from deepgps.data.segments import travel
from deepgps.positioner.pose import find_poses
from deepgps.positioner.positioner import Positioner
from deepgps.tracking.filter import State, begin, estimate, predict, see
from deepgps.tracking.fix import begin_trail, take_fix
from deepgps.tracking.motion import Motion, mirror
from sim.errors import InputError
from sim.geometry import wrap
from sim.sensors.encoder import expect_variance

IMAGE_M, IMAGE_RAD = 0.1, np.radians(15.0)  # An image is taken after so much distance or turn [m], [rad]
DISTANCE_STD_SHARE, TURN_STD_SHARE = 0.01, 0.02  # Of a distance or a turn by the wheels, beside the encoders' noise
REST_STD_M, REST_STD_RAD = 0.0005, 0.002  # Least standard deviations of a motion [m], [rad]
MATCH_M, MATCH_RAD = 0.3, 0.35  # An image supports a pose that is nearer to its own than this [m], [rad]
CARRIED_IMAGES = 3  # After so many accepted images in a row that contradict, the robot was carried
SUPPORTING_IMAGES = 2  # So many images in a row must support a pose that is not certain
BLIND_M, BLIND_RAD = (
    1.0,
    6.0,
)  # Way and turn without an image that supports the pose, after which it is unsure [m], [rad]


class Source(Protocol):
    """Says where the robot is."""

    hand: int  # 1; -1: the frame is mirrored

    def pose(self) -> np.ndarray:
        """The pose x, y [m], yaw [rad] (3,) now; NaN: unknown."""
        ...

    def covariance(self) -> np.ndarray:
        """Covariance (2, 2) of the position [m^2]; zero: the source tells none."""
        ...

    def move(self, ticks: np.ndarray) -> None:
        """Take the encoders' ticks (2,)."""
        ...

    def wants_image(self) -> bool:
        """Whether it wants an image now."""
        ...

    def see(self, image: np.ndarray) -> None:
        """Take an image (...), which may be taken without having been wanted."""
        ...

    def is_sure(self) -> bool:
        """Whether the robot may drive by the pose."""
        ...

    def is_certain(self) -> bool:
        """Whether the robot may say that it has arrived, by the pose."""
        ...

    def pack(self) -> dict[str, np.ndarray]:
        """What it knows between two goals, as arrays by name."""
        ...

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Continue with what it knew."""
        ...


class Wheels:
    """The robot's way by its encoders since some time, in its own frame then."""

    def __init__(self, odometry: Mapping[str, float]) -> None:
        self.odometry, self._ticks = odometry, None
        self.restart()

    def restart(self) -> None:
        """Count from now on."""
        self.step, self.turn, self.wheels_m, self.turned_rad = np.zeros(2), 0.0, np.zeros(2), 0.0

    def move(self, ticks: np.ndarray) -> None:
        """Take the encoders' ticks (2,)."""
        if self._ticks is not None:
            left, right = travel(ticks - self._ticks, self.odometry).tolist()
            turn, middle = (right - left) / self.odometry["track_m"], self.turn
            middle += turn / 2.0
            self.step = self.step + (left + right) / 2.0 * np.array([np.cos(middle), np.sin(middle)])
            self.turn += turn
            self.wheels_m = self.wheels_m + np.abs([left, right])
            self.turned_rad += abs(turn)
        self._ticks = np.array(ticks)

    @property
    def moved_m(self) -> float:
        """Distance driven [m]."""
        return float(self.wheels_m.mean()) if np.linalg.norm(self.step) > REST_STD_M else 0.0

    def motion(self) -> Motion:
        """The motion, with the errors that are expected of wheels and encoders."""
        way_m, total_m = float(np.linalg.norm(self.step)), float(self.wheels_m.sum())
        noise = float(expect_variance(self.odometry, total_m, 1))  # that of one wheel
        turn_var = 2.0 * noise / self.odometry["track_m"] ** 2 + (TURN_STD_SHARE * self.turned_rad) ** 2
        ahead_var = noise / 2.0 + (DISTANCE_STD_SHARE * way_m) ** 2 + REST_STD_M**2
        aside_var = turn_var * way_m**2 / 4.0 + REST_STD_M**2
        return Motion(self.step, self.turn, np.diag([ahead_var, aside_var, turn_var + REST_STD_RAD**2]))


def follow(pose: np.ndarray, wheels: Wheels, hand: int) -> np.ndarray:
    """The pose (3,) after a way by the wheels, in a frame of this hand."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    ahead, left = wheels.step[0], hand * wheels.step[1]
    return pose + np.array([cos * ahead - sin * left, sin * ahead + cos * left, hand * wheels.turn])


class Reckoned:
    """Dead reckoning by the encoders alone, from a known start (3,)."""

    def __init__(self, odometry: Mapping[str, float], start: np.ndarray, hand: int = 1) -> None:
        self._wheels, self._start, self.hand = Wheels(odometry), np.asarray(start, float), hand

    def pose(self) -> np.ndarray:
        return follow(self._start, self._wheels, self.hand)

    def covariance(self) -> np.ndarray:
        return np.zeros((2, 2))

    def move(self, ticks: np.ndarray) -> None:
        self._start = self.pose()
        self._wheels.restart()
        self._wheels.move(ticks)

    def wants_image(self) -> bool:
        return False

    def see(self, image: np.ndarray) -> None:
        pass

    def is_sure(self) -> bool:
        return True

    is_certain = is_sure

    def pack(self) -> dict[str, np.ndarray]:
        return {"pose": self.pose()}

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        self._start = arrays["pose"]
        self._wheels.restart()


class Given(Reckoned):
    """The pose that a function tells at any time: of the true one, the ceiling."""

    def __init__(self, find: Callable[[], np.ndarray], hand: int = 1) -> None:
        self._find, self.hand = find, hand

    def pose(self) -> np.ndarray:
        return self._find()

    def move(self, ticks: np.ndarray) -> None:
        pass

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        pass


class Tracked:
    """Positions of a trained method by images, tracked with the encoders by the filter.

    The robot was carried if a few images in a row, all accepted, contradict the pose: then the filter begins again.
    """

    def __init__(self, positioner: Positioner, odometry: Mapping[str, float], name: str = "the method") -> None:
        """Take a positioner; raises InputError if it gives no yaw."""
        if positioner.mirrored is None:
            raise InputError(f"{name} gives no yaw, so the robot cannot drive by it")
        self.hand = -1 if positioner.mirrored else 1
        self._positioner, self._wheels = positioner, Wheels(odometry)
        self._forget()

    def pose(self) -> np.ndarray:
        best = estimate(self._state)
        pose = follow(np.array([*best.position, best.yaw]), self._wheels, self.hand)
        pose[2] = wrap(pose[2])
        return pose

    def covariance(self) -> np.ndarray:
        state = predict(self._state, self._find_motion())
        return state.covariance[state.evidence.argmax(), :2, :2] if len(state.mean) else np.full((2, 2), np.nan)

    def move(self, ticks: np.ndarray) -> None:
        self._wheels.move(ticks)

    def wants_image(self) -> bool:
        return self._wheels.moved_m >= IMAGE_M or self._wheels.turned_rad >= IMAGE_RAD

    def see(self, image: np.ndarray) -> None:
        fix, wheels = take_fix(find_poses(self._positioner, image[None]).take(0)), self._wheels
        self._blind = self._blind + (wheels.moved_m, wheels.turned_rad)
        self._state = predict(self._state, self._find_motion())
        wheels.restart()
        pose = self.pose()
        near = bool(
            np.linalg.norm(fix.position - pose[:2]) < MATCH_M
            and (np.isnan(fix.yaw) or abs(wrap(fix.yaw - pose[2])) < MATCH_RAD)
        )
        accepted = fix.usable and fix.accepted and not fix.others
        self._contradicting = self._contradicting + 1 if accepted and not near else 0
        if self._contradicting >= CARRIED_IMAGES:
            self._forget()
        self._state = see(self._state, fix)
        if accepted and (near or not self._supporting):
            self._supporting, self._blind = self._supporting + 1, np.zeros(2)
        elif accepted:
            self._supporting = 0

    def is_sure(self) -> bool:
        seen = not self._contradicting and (self._blind < (BLIND_M, BLIND_RAD)).all()
        return bool(seen and (self._supporting >= SUPPORTING_IMAGES or estimate(self._state).accepted))

    def is_certain(self) -> bool:
        return self.is_sure() and estimate(self._state).accepted

    def pack(self) -> dict[str, np.ndarray]:
        state = predict(self._state, self._find_motion())
        return {
            "mean": state.mean,
            "covariance": state.covariance,
            "evidence": state.evidence,
            "blind": self._blind,
            "counts": np.array([self._supporting, self._contradicting]),
        }

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        known = (arrays[name] for name in ("mean", "covariance", "evidence"))
        self._state = State(*known, begin_trail(), mapped=self._positioner.mapped)
        self._supporting, self._contradicting = arrays["counts"].tolist()
        self._blind = arrays["blind"]
        self._wheels.restart()

    def _forget(self) -> None:
        """Know nothing of the pose."""
        self._state, self._supporting, self._contradicting = begin(self._positioner.mapped), 0, 0
        self._blind = np.zeros(2)

    def _find_motion(self) -> Motion:
        motion = self._wheels.motion()
        return mirror(motion) if self.hand < 0 else motion
