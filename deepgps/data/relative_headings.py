"""Relative headings of images taken centimetres apart: how far one is turned against the other, from the images alone.

So far apart, a coarse description is as good as the whole images: a few rings without colours, and slow waves around
the circle. Error RMS: 0.2 to 0.4 degrees within 2 cm, 13 degrees for each metre beyond.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from deepgps.data.segments import Segments
from sim.geometry import wrap
from sim.sensors.compass import find_highest

RINGS = 8
WAVES = 24
"""Highest number of cycles around the circle."""
SMOOTH = 6.0
"""Slow changes of light are suppressed by k / (k + SMOOTH), k in cycles around the circle."""
FINER = 8
"""Samples of the correlation for each cycle of the highest wave."""
AMBIGUOUS = 0.9
"""A second peak of the correlation above this part of the first leaves the heading open."""
STEPS = 1500
"""Steps between readings that measure the curvature at most."""
LARGEST_RAD = 0.5
"""No robot turns by more from one reading to the next of a segment [rad]."""
CHUNK = 1000


@dataclass(frozen=True)
class Headings:
    """Relative headings of n pairs of images.

    Attributes:
        turn: Angle from the first image's heading to the second's, to the left (n,) [rad].
        clear: Whether the correlation has one highest peak only (n,) bool.
    """

    turn: np.ndarray
    clear: np.ndarray


def compare_headings(images: np.ndarray, first: np.ndarray, second: np.ndarray) -> Headings:
    """Compare the headings of pairs of polar images.

    Args:
        images: Polar images (N, rings, sectors, channels).
        first: Numbers of the first images (n,).
        second: Numbers of the second images (n,).
    """
    seen, place = np.unique(np.concatenate([first, second]), return_inverse=True)
    waves = _describe_all(images, seen)
    one, other = place[: len(first)], place[len(first) :]
    turn, clear = np.empty(len(first)), np.empty(len(first), bool)
    for start in range(0, len(first), CHUNK):
        part = slice(start, start + CHUNK)
        turn[part], clear[part] = _compare(waves[one[part]], waves[other[part]])
    return Headings(turn, clear)


def measure_curvature(images: np.ndarray, segments: Segments) -> float:
    """Measure the curvature of what the robot drives for straight, to the left [1 / m]; right to about 0.01.

    What the robot passes on its left and right turns single pairs of images, and the mean hardly.

    Args:
        images: Polar images (N, rings, sectors, channels).
        segments: Segments through them; their first readings may have been taken before a turn and do not count.
    """
    valid = segments.valid.numpy()[:, 2:]
    index, distance = segments.index.numpy()[:, 1:], segments.distance.numpy()[:, 1:]
    first, second = index[:, :-1][valid], index[:, 1:][valid]
    step = (distance[:, 1:] - distance[:, :-1])[valid]
    chosen = np.linspace(0, len(step) - 1, min(STEPS, len(step))).astype(int)
    headings = compare_headings(images, first[chosen], second[chosen])
    used = headings.clear & (np.abs(headings.turn) < LARGEST_RAD)
    driven = float(step[chosen][used].sum())
    return float(headings.turn[used].sum()) / driven if driven > 0.0 else 0.0


def _describe_all(images: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    parts = [_describe(images[chosen[i : i + CHUNK]]) for i in range(0, len(chosen), CHUNK)]
    return np.concatenate(parts) if parts else np.empty((0, RINGS, WAVES + 1), np.complex64)


def _describe(images: np.ndarray) -> np.ndarray:
    """Waves (n, RINGS, WAVES + 1) around the rings, weighted by their circumference in a fisheye image."""
    rings, sectors = images.shape[1:3]
    channels = images.reshape(-1, images.shape[3]).astype(np.float32)
    grey = (channels @ np.full(images.shape[3], 1.0 / images.shape[3], np.float32)).reshape(images.shape[:3])
    ring = np.arange(rings)
    block = min(RINGS, rings) * ring // rings
    gather = np.where(block == np.unique(block)[:, None], np.sqrt(ring + 0.5), 0.0).astype(np.float32)
    blocks = gather @ grey
    wave = np.arange(min(WAVES, sectors // 2 - 1) + 1)
    return (np.asarray(fft.rfft(blocks))[..., : len(wave)] * (wave / (wave + SMOOTH))).astype(np.complex64)


def _compare(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    correlation = np.asarray(fft.irfft((one * other.conj()).sum(axis=1), FINER * 2 * WAVES))
    angle, height = find_highest(correlation, 2)
    return wrap(angle[:, 0]), height[:, 1] < AMBIGUOUS * height[:, 0]
