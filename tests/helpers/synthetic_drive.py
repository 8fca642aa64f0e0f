"""A made-up drive of straight segments and turns in place, with images whose errors are drawn."""

from dataclasses import dataclass

import numpy as np

from deepgps.tracking.fix import Fix
from deepgps.tracking.motion import Motion, make_motion
from sim.geometry import wrap

SPACING_M, PLACE_STD_M, YAW_STD_RAD = 0.12, 0.02, 0.03
STEP_STD_M, TURN_STD_RAD = 0.005, 0.01


@dataclass(frozen=True)
class Drive:
    """True poses (M, 3), and what odometry and images say of them (M,)."""

    pose: np.ndarray
    motions: list[Motion | None]
    fixes: list[Fix]


def make_drive(rng: np.random.Generator, images: int = 150, noise: float = 1.0, outliers: float = 0.0) -> Drive:
    """A drive with a turn after every eighth image.

    Args:
        rng: Draws the drive and all errors.
        images: Number of images, M.
        noise: Factor of the standard deviations of all errors; those that are told are the same.
        outliers: Share of the images that show any place within 5 m.
    """
    pose, motions = [np.zeros(3)], list[Motion | None]([None])
    for number in range(1, images):
        turn = rng.uniform(-2.0, 2.0) if number % 8 == 0 else 0.0
        drawn = rng.standard_normal(3) * [STEP_STD_M, STEP_STD_M, TURN_STD_RAD]
        motions.append(make_motion(SPACING_M, 0.0, turn, STEP_STD_M, TURN_STD_RAD))
        pose.append(advance(pose[-1], np.array([SPACING_M, 0.0, turn]) + noise * drawn))
    drawn = noise * rng.standard_normal((images, 3)) * [PLACE_STD_M, PLACE_STD_M, YAW_STD_RAD]
    seen = np.array(pose) + drawn
    lost = rng.random(images) < outliers
    seen[lost, :2] = rng.uniform(-5.0, 5.0, (int(lost.sum()), 2))
    return Drive(np.array(pose), motions, [see(one) for one in seen])


def carry(drive: Drive) -> Drive:
    """The drive of a robot that was carried from its 80th image to its 131st, without its odometry noticing."""
    path = np.concatenate([drive.pose[:80], drive.pose[130:]])
    return Drive(path, drive.motions[:80] + drive.motions[130:], drive.fixes[:80] + drive.fixes[130:])


def advance(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The pose after a motion, forward, left and turn, both (3,)."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    forward, left, turn = motion
    return np.array([pose[0] + cos * forward - sin * left, pose[1] + sin * forward + cos * left, pose[2] + turn])


def see(pose: np.ndarray) -> Fix:
    """An image that says that the robot is there (3,)."""
    return Fix(pose[:2], PLACE_STD_M, float(wrap(pose[2])), YAW_STD_RAD)
