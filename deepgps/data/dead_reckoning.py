"""The path from encoders alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim.recording.format import Recording
from sim.sensors.encoder import check_odometry, count_from_first, ticks_to_distance


def travel(ticks: np.ndarray, constants: Mapping[str, Any]) -> np.ndarray:
    """Distance travelled by each wheel [m] from its cumulative ticks, both (R, 2); only differences are meaningful."""
    odometry = check_odometry(constants)
    return ticks_to_distance(count_from_first(ticks), odometry["wheel_radius_m"], odometry["ticks_per_rev"])


def dead_reckon(recording: Recording) -> np.ndarray:
    """Dead-reckoned pose at each reading (R, 3): x, y [m], yaw [rad], starting at (0, 0, 0).

    In each step the robot turns by the difference of the wheels' distances over the track, and drives their mean along
    the mean heading. Between segments it first backs off from what it touched and then turns in place.
    """
    way = np.diff(travel(recording.reading[:, 2:], recording.manifest.odometry), axis=0)
    turn = (way[:, 1] - way[:, 0]) / check_odometry(recording.manifest.odometry)["track_m"]
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    heading = yaw[:-1] + turn / 2.0
    between = np.diff(recording.reading[:, 0]) != 0
    heading = np.where(between, yaw[:-1], heading)
    step = way.mean(axis=1)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    return np.concatenate([place, yaw[:, None]], axis=1)
