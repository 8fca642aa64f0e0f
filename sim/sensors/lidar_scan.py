"""The scan, a lidar's observation: ordered distances all around, at one or more headings. It needs no MuJoCo.

The array is (..., headings, rays) float32 [m]. Ray i of heading j looks at ``2 pi (i + j / headings) / rays`` from
straight ahead, to the left: heading j is what the robot would see if it turned left by j / headings of the angle
between two rays. A turn by a full ray shifts each row circularly, so these rows give the scan at every heading.
"""

import numpy as np

from sim.rng import stream
from sim.sensors.catalog import Measure, Measures
from sim.settings import LidarSettings, SimSettings

LIDAR_REACH_M = 8.0
"""Longest distance measured [m] (LDS-02, the TurtleBot3's lidar); also the reading if nothing is nearer."""


def ray_angles(lidar: LidarSettings) -> np.ndarray:
    """Angles of all rays cast at one place, counter-clockwise from straight ahead (headings rays,) [rad]."""
    count = lidar.rays * lidar.headings
    return 2.0 * np.pi * np.arange(count) / count


def arrange(distance: np.ndarray, lidar: LidarSettings) -> np.ndarray:
    """Arrange distances (..., headings rays) [m], ordered as ``ray_angles``, as scans (..., headings, rays) float32."""
    by_ray = distance.reshape(*distance.shape[:-1], lidar.rays, lidar.headings)
    return np.ascontiguousarray(np.swapaxes(by_ray, -1, -2), np.float32)


def measure(distance: np.ndarray, lidar: LidarSettings, rng: np.random.Generator) -> np.ndarray:
    """Distances that the sensor measures: the true ones plus noise, between zero and its reach."""
    if lidar.noise_m > 0.0:
        distance = distance + lidar.noise_m * rng.standard_normal(distance.shape, np.float32)
    return np.clip(distance, 0.0, LIDAR_REACH_M, dtype=np.float32)


def make_measures(settings: SimSettings, seed: int) -> Measures:
    """Return what adds the noise to scans, each part of a recording from a stream of its own."""

    def make(part: str) -> Measure:
        noise = stream(seed, "lidar", part)
        return lambda scans: measure(scans, settings.lidar, noise)

    return Measures(*(make(part) for part in Measures._fields))
