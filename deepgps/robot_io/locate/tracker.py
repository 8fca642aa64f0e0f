"""Tracking while images come: each pose by the images so far and the odometry between them."""

from dataclasses import dataclass, field

import numpy as np

from deepgps.positioner.confidence import LEVELS, find_normal_radius
from deepgps.positioner.pose import Poses
from deepgps.tracking.filter import State, advance, begin, estimate
from deepgps.tracking.fix import take_fix
from deepgps.tracking.motion import Motion, make_motion, mirror

WAY, STILL_M = 0.01, 0.001
"""Standard deviation of the way between two images, as a part of it and at least [m]."""
AT_REST_M, AT_REST_RAD = 1e-4, 1e-3
"""Way and turn between two images up to which the robot rests, so that they share all their errors [m], [rad]."""
SLIP, STILL_RAD = 0.1, 0.01
"""Standard deviation of the turn between two images, as a part of it and at least [rad]."""


@dataclass
class Tracker:
    """Tracks the robot through a stream of images.

    Attributes:
        mirrored: Whether a turn to the left is one to the right in the method's map.
        travelled_m: Distance at the last image [m]; NaN: unknown.
        yaw: Heading by odometry there [rad].
        state: The filter's state.
    """

    mirrored: bool
    travelled_m: float = np.nan
    yaw: float = np.nan
    state: State = field(default_factory=begin)

    def step(self, pose: Poses, travelled_m: float, yaw: float) -> Poses:
        """The tracked pose at an image, in the method's frame.

        Args:
            pose: Pose of the image alone, without the axis B.
            travelled_m: Distance driven by the wheels [m]; NaN: unknown.
            yaw: Heading by the wheels [rad].
        """
        motion = self._find_motion(travelled_m, yaw)
        self.travelled_m, self.yaw = travelled_m, yaw
        self.state = advance(self.state, motion, take_fix(pose))
        found = estimate(self.state)
        radius = found.position_std * find_normal_radius(np.array(LEVELS))
        return Poses(
            found.position,
            position_std=np.asarray(found.position_std),
            yaw=np.asarray(found.yaw),
            yaw_std=np.asarray(found.yaw_std),
            radius_68=radius[0],
            radius_95=radius[1],
            accepted=np.asarray(found.accepted),
        )

    def _find_motion(self, travelled_m: float, yaw: float) -> Motion | None:
        """The motion since the last image; None: it is not known."""
        way, turn = travelled_m - self.travelled_m, yaw - self.yaw
        if not np.isfinite([way, turn]).all():
            return None
        rests = abs(way) < AT_REST_M and abs(turn) < AT_REST_RAD
        # The robot turns and drives at the same time: half of the turn comes first.
        motion = make_motion(
            way * np.cos(turn / 2),
            way * np.sin(turn / 2),
            turn,
            WAY * abs(way) + (0.0 if rests else STILL_M),
            SLIP * abs(turn) + (0.0 if rests else STILL_RAD),
        )
        return mirror(motion) if self.mirrored else motion
