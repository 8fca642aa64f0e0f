"""Relative headings of loop closures: how far the second image is turned against the first, from the images alone.

Unlike the images of a turn, both were taken centimetres apart, so a coarse description is as good as the whole images:
a few rings without colours, and slow waves around the circle.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

RINGS = 8
WAVES = 24
"""Highest number of cycles around the circle."""
SMOOTH = 6.0
"""Slow changes of light are suppressed by k / (k + SMOOTH), k in cycles around the circle."""
FINER = 8
"""Samples of the correlation for each cycle of the highest wave."""
AMBIGUOUS = 0.9
"""A second peak of the correlation above this part of the first leaves the heading open."""
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


def _describe_all(images: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    parts = [_describe(images[chosen[i : i + CHUNK]]) for i in range(0, len(chosen), CHUNK)]
    return np.concatenate(parts) if parts else np.empty((0, RINGS, WAVES + 1), np.complex64)


def _describe(images: np.ndarray) -> np.ndarray:
    """Waves (n, RINGS, WAVES + 1) around the rings, weighted by their circumference in a fisheye image."""
    rings, sectors = images.shape[1:3]
    grey = np.asarray(images).mean(axis=3, dtype=np.float32)
    edges = np.linspace(0, rings, min(RINGS, rings) + 1).astype(int)
    weight = np.sqrt(np.arange(rings) + 0.5).astype(np.float32)[:, None]
    blocks = np.add.reduceat(grey * weight, edges[:-1], axis=1)
    wave = np.arange(min(WAVES, sectors // 2 - 1) + 1)
    return (fft.rfft(blocks)[..., : len(wave)] * (wave / (wave + SMOOTH))).astype(np.complex64)


def _compare(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = FINER * 2 * WAVES
    cross = (one * other.conj()).sum(axis=1)
    correlation = np.asarray(fft.irfft(cross, count))
    before, after = np.roll(correlation, 1, axis=1), np.roll(correlation, -1, axis=1)
    peaks = np.where((correlation > before) & (correlation >= after), correlation, -np.inf)
    row, best = np.arange(len(peaks)), peaks.argmax(axis=1)
    top = peaks[row, best]
    a, b = before[row, best], after[row, best]
    aside = (a - b) / (2.0 * (a - 2.0 * top + b))
    peaks[row, best] = -np.inf
    angle = 2.0 * np.pi / count * (best + aside)
    return (angle + np.pi) % (2.0 * np.pi) - np.pi, peaks.max(axis=1) < AMBIGUOUS * top
