"""What the robot's sensors and the truth read during a drive, whenever a timer of their computer fires."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sim.geometry import planar_pose
from sim.robot.range_finder import ANGLE
from sim.robot_log.clocks import RECORDER, Clock
from sim.robot_log.trace import Stretch, TracedWorld

JOINT_S, PICTURE_S, RAY_S, TRUTH_S = 0.05, 0.1, 0.2, 0.05
"""Periods of the wheels (TurtleBot3: 20 Hz), the pictures, the rays and the truth [s]."""


@dataclass(frozen=True)
class Observed:
    """Readings with their times in the simulation [s].

    Attributes:
        joint_time: Times of the wheel angles (J,).
        joint_angle: Left and right wheel angle (J, 2) [rad].
        picture_time: Times of the pictures (P,).
        picture_state: Full positions at them (P, nq).
        ray_time: Times of the rays (Q,).
        ray_m: Distance to what is nearest in each direction, at any height of the robot (Q, K) [m].
        truth_time: Times of the true poses (T,).
        truth_pose: True poses (T, 3) x, y [m], yaw [rad].
    """

    joint_time: np.ndarray
    joint_angle: np.ndarray
    picture_time: np.ndarray
    picture_state: np.ndarray
    ray_time: np.ndarray
    ray_m: np.ndarray
    truth_time: np.ndarray
    truth_pose: np.ndarray


def observe(world: TracedWorld, stretch: Stretch, base: Clock) -> Observed:
    """Read everything in a stretch of the drive; ``base`` is the clock of the wheels and the rays."""
    joint, ray = (stretch.find(base, period_s) for period_s in (JOINT_S, RAY_S))
    picture, truth = (stretch.find(RECORDER, period_s) for period_s in (PICTURE_S, TRUTH_S))
    fans = [world.ranges_at(pose).reshape(-1, len(ANGLE)) for pose in planar_pose(stretch.state[ray])]
    return Observed(
        joint_time=stretch.time[joint],
        joint_angle=stretch.state[joint][:, world.wheels],
        picture_time=stretch.time[picture],
        picture_state=stretch.state[picture],
        ray_time=stretch.time[ray],
        ray_m=np.array([fan.min(axis=0) for fan in fans]).reshape(-1, len(ANGLE)),
        truth_time=stretch.time[truth],
        truth_pose=planar_pose(stretch.state[truth]),
    )


def join(parts: Sequence[Observed]) -> Observed:
    """All readings of consecutive stretches."""
    names = [field.name for field in fields(Observed)]
    return Observed(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
