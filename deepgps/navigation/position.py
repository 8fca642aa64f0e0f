"""Where the robot is, as its controller takes it: told, by wheels alone, or tracked by images and wheels.

All poses are in the method's own frame. Where that is mirrored, a turn to the left is one to the right in it: then the
``hand`` is -1, else 1.
"""

from collections.abc import Callable, Mapping

import numpy as np

from deepgps.data.segments import travel
from deepgps.positioner.pose import find_poses
from deepgps.positioner.positioner import Positioner
from deepgps.tracking.filter import State, begin, estimate, predict, see
from deepgps.tracking.fix import begin_trail, take_fix
from deepgps.tracking.motion import Motion, rotate
from sim.errors import InputError
from sim.geometry import wrap
from sim.sensors.encoder import expect_variance

IMAGE_M, IMAGE_RAD = 0.1, np.radians(15.0)  # An image is taken after so much distance or turn [m], [rad]
DISTANCE_STD_SHARE, TURN_STD_SHARE = 0.01, 0.02  # Of a distance or a turn by the wheels, beside the encoders' noise
REST_STD_M, REST_STD_RAD = 0.0005, 0.002  # Least standard deviations of a motion [m], [rad]
MATCH_M, MATCH_RAD = 0.3, 0.35  # An image supports a pose that is nearer to its own than this [m], [rad]
CARRIED_IMAGES = 3  # After so many accepted images in a row that contradict the pose, the robot was carried
DRIVING_IMAGES, ARRIVAL_IMAGES = 2, 6
"""So many images in a row support a pose by which the robot drives, and says that it is there."""
STATE = ("mean", "covariance", "evidence")  # Arrays of the filter's state
BLIND_LIMITS = np.array([1.0, 6.0])  # Way and turn without such an image, after which the robot is unsure [m], [rad]


class Source:
    """Says where the robot is: as a function tells, as for the true pose; always sure, without images or wheels."""

    def __init__(self, find: Callable[[], np.ndarray], hand: int = 1) -> None:
        self._find, self.hand = find, hand

    def pose(self) -> np.ndarray:
        """The pose x, y [m], yaw [rad] (3,) now; NaN: unknown."""
        return self._find()

    def covariance(self) -> np.ndarray:
        """Covariance (2, 2) of the position [m^2]; zero: the source tells none."""
        return np.zeros((2, 2))

    def move(self, ticks: np.ndarray) -> None:
        """Take the cumulative ticks (2,) of the encoders now."""

    def wants_image(self) -> bool:
        """Whether it wants an image now."""
        return False

    def see(self, image: np.ndarray) -> None:
        """Take an image (rings, sectors, 3), wanted or not."""

    def is_sure(self, images: int = DRIVING_IMAGES) -> bool:
        """Whether so many images in a row, or its filter, support the pose."""
        return True

    def pack(self) -> dict[str, np.ndarray]:
        """What it knows between two goals, as arrays by name."""
        return {}

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Continue with what another source knew; the encoders count on."""


class Wheels:
    """The robot's way by its encoders since a restart, in its own frame then; a hand of -1 mirrors it."""

    def __init__(self, odometry: Mapping[str, float], hand: int = 1) -> None:
        self.odometry, self._hand, self._ticks = odometry, hand, None
        self.restart()

    def restart(self) -> None:
        self.step, self.turn, self.driven_m, self.turned_rad = np.zeros(2), 0.0, 0.0, 0.0

    def move(self, ticks: np.ndarray) -> None:
        if self._ticks is not None:
            left, right = travel(ticks - self._ticks, self.odometry)[:: self._hand].tolist()
            turn = (right - left) / self.odometry["track_m"]
            middle = self.turn + turn / 2.0
            self.step = self.step + (left + right) / 2.0 * np.array([np.cos(middle), np.sin(middle)])
            self.turn, self.turned_rad = self.turn + turn, self.turned_rad + abs(turn)
            self.driven_m += (abs(left) + abs(right)) / 2.0  # of both wheels, also in a turn in place
        self._ticks = np.array(ticks)

    @property
    def way_m(self) -> float:
        """Distance from where they were restarted [m]."""
        return float(np.linalg.norm(self.step))

    def motion(self) -> Motion:
        """The motion, with the errors that are expected of wheels and encoders."""
        noise = float(expect_variance(self.odometry, self.driven_m, 1))  # of the mean of both wheels
        turn = 4.0 * noise / self.odometry["track_m"] ** 2 + (TURN_STD_SHARE * self.turned_rad) ** 2 + REST_STD_RAD**2
        ahead = noise + (DISTANCE_STD_SHARE * self.way_m) ** 2 + REST_STD_M**2
        return Motion(self.step, self.turn, np.diag([ahead, turn * self.way_m**2 / 4.0 + REST_STD_M**2, turn]))

    def follow(self, pose: np.ndarray) -> np.ndarray:
        """The pose (3,) now by that at the restart."""
        return np.array([*(pose[:2] + rotate(pose[2]) @ self.step), wrap(pose[2] + self.turn)])


class Reckoned(Source):
    """Dead reckoning by the encoders alone, from a known start (3,)."""

    def __init__(self, odometry: Mapping[str, float], start: np.ndarray, hand: int = 1) -> None:
        self._wheels, self._start = Wheels(odometry, hand), start
        super().__init__(lambda: self._wheels.follow(self._start), hand)

    def move(self, ticks: np.ndarray) -> None:
        self._wheels.move(ticks)

    def pack(self) -> dict[str, np.ndarray]:
        return {"source_pose": self.pose()}

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        self._start = arrays["source_pose"]


class Tracked(Source):
    """Positions of a trained method by images, tracked with the encoders by the filter.

    The robot was carried if a few accepted images in a row contradict the pose: then the filter begins again.
    """

    def __init__(self, positioner: Positioner, odometry: Mapping[str, float], name: str = "the method") -> None:
        """Take a positioner; raises InputError, which names the method, if it gives no yaw."""
        if positioner.mirrored is None:
            raise InputError(f"{name} gives no yaw, so a robot cannot drive by it")
        self.hand = -1 if positioner.mirrored else 1
        self._positioner, self._wheels = positioner, Wheels(odometry, self.hand)
        self._forget()

    def pose(self) -> np.ndarray:
        best = estimate(self._state)
        return self._wheels.follow(np.array([*best.position, best.yaw]))

    def covariance(self) -> np.ndarray:
        state = self._predict()
        return state.covariance[state.evidence.argmax(), :2, :2] if len(state.mean) else np.full((2, 2), np.nan)

    def move(self, ticks: np.ndarray) -> None:
        self._wheels.move(ticks)

    def wants_image(self) -> bool:
        return self._wheels.way_m >= IMAGE_M or self._wheels.turned_rad >= IMAGE_RAD

    def see(self, image: np.ndarray) -> None:
        fix, pose = take_fix(find_poses(self._positioner, image[None]).take(0)), self.pose()
        self._blind = self._blind + (self._wheels.way_m, self._wheels.turned_rad)
        self._state = self._predict()
        self._wheels.restart()
        away_m, away_rad = float(np.linalg.norm(fix.position - pose[:2])), abs(wrap(fix.yaw - pose[2]))
        near = away_m < MATCH_M and not away_rad >= MATCH_RAD  # a yaw may be NaN
        accepted = fix.usable and fix.accepted and not fix.others
        self._contradicting = self._contradicting + 1 if accepted and not near and np.isfinite(away_m) else 0
        if self._contradicting >= CARRIED_IMAGES:
            self._forget()
        self._state = see(self._state, fix)
        if accepted and (near or not self._supporting):
            self._supporting, self._blind = self._supporting + 1, np.zeros(2)
        elif accepted:
            self._supporting = 0

    def is_sure(self, images: int = DRIVING_IMAGES) -> bool:
        seen = not self._contradicting and (self._blind < BLIND_LIMITS).all()
        return bool(seen and (self._supporting >= images or estimate(self._state).accepted))

    def pack(self) -> dict[str, np.ndarray]:
        state, counts = self._predict(), np.array([self._supporting, self._contradicting])
        known = {f"source_{name}": getattr(state, name) for name in STATE}
        return {**known, "source_blind": self._blind, "source_counts": counts}

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        mean, covariance, evidence = (arrays[f"source_{name}"] for name in STATE)
        self._state = State(mean, covariance, evidence, begin_trail(), mapped=self._positioner.mapped)
        self._blind, (self._supporting, self._contradicting) = arrays["source_blind"], arrays["source_counts"].tolist()

    def _forget(self) -> None:
        """Know nothing of the pose."""
        self._state, self._blind = begin(self._positioner.mapped), np.zeros(2)
        self._supporting = self._contradicting = 0

    def _predict(self) -> State:
        """The filter's state now."""
        return predict(self._state, self._wheels.motion())
