"""A robot in its room for a controller from outside: motors in; ticks, ranges, bumper and images out.

What no robot can sense is that of ``RoomWorld``: ``pose``, ``is_free``, ``place`` and ``state``; ``pack`` holds it.
"""

from collections.abc import Mapping

import numpy as np

from sim.recording.chunks import observe
from sim.rng import split
from sim.robot.model import CONTROL_PERIOD_S, wheel_speeds
from sim.robot.motion import look
from sim.robot.world import RoomWorld
from sim.sensors.camera.faults import make_develop
from sim.sensors.camera.mount import draw_leans
from sim.sensors.encoder import count_ticks, describe_odometry, disturb_gaps, scale_wheels, slip_wheels
from sim.settings import SimSettings

SENSOR = "fisheye"


class LiveRobot(RoomWorld):
    """A robot with wheel encoders, range finder, bumper and fisheye camera.

    Encoder faults that are drawn for a complete drive (lost readings, a stuck encoder, those of plugins) are left out.
    """

    period_s = CONTROL_PERIOD_S  # How long a step lasts [s]

    def __init__(self, settings: SimSettings) -> None:
        self._angle = self._read = np.zeros(2)  # of the wheels, true and by the encoders [rad]
        super().__init__(settings, drawn=False)
        body = self.body
        self.odometry: Mapping[str, float] = describe_odometry(settings.encoder, body.wheel_radius_m, body.track_m)

    def begin(self, rng: np.random.Generator) -> None:
        """Draw all noise from now on from the streams of a generator."""
        self._slip, self._gaps, self._lean, noise = (split(rng, name) for name in ("slip", "gaps", "lean", "image"))
        self._develop = make_develop(self.settings.image_faults, noise)

    def drive(self, speed_mps: float, turn_rate_rps: float) -> None:
        """Drive at a speed [m/s] and turn to the left [rad/s] for a period; raises WorkError if physics fails."""
        self.step(wheel_speeds(speed_mps, turn_rate_rps, self.body))
        encoder, angle = self.settings.encoder, np.stack([self._angle, self.wheel_angle()])
        seen = scale_wheels(angle, encoder.radius_error_left, encoder.radius_error_right)
        seen = slip_wheels(seen, encoder.slip_per_m, self.body.wheel_radius_m, self._slip)
        seen = disturb_gaps(seen, encoder.step_noise, self._gaps)
        self._angle, self._read = angle[1], self._read + (seen[1] - seen[0])

    def ticks(self) -> np.ndarray:
        """Cumulative ticks (2,) of the left and right encoder, int64."""
        return count_ticks(self._read, self.settings.encoder)

    def clear_m(self, reach_m: float, turned_rad: float = 0.0) -> float:
        """How far the robot could drive before a contact [m], at most the reach, at an angle to the left [rad]."""
        return look(self, reach_m, turned_rad)

    def image(self) -> np.ndarray:
        """The polar image (rings, sectors, 3) uint8 that the camera takes now."""
        leans = draw_leans(self.settings.camera_mount, 1, self._lean)
        seen = observe(SENSOR, self.settings, self.snapshot()[None], leans)
        return (seen if self._develop is None else self._develop(seen))[0]

    def put(self, pose: np.ndarray) -> None:
        """Put the robot at a true pose (3,), at rest; the encoders keep what they have counted."""
        self.place(pose)
        self._angle = self.wheel_angle()

    def pack(self) -> dict[str, np.ndarray]:
        """All on which what follows depends, but the generator of its noise, as arrays by name."""
        return {"robot_state": self.state(), "robot_angle": self._angle, "robot_read": self._read}

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Stand and move as another robot did, whose encoders had counted the same."""
        self.set_state(arrays["robot_state"])
        self._angle, self._read = arrays["robot_angle"], arrays["robot_read"]
