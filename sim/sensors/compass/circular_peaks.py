"""Peaks of curves that are sampled around a circle, such as correlations of polar images."""

import numpy as np


def find_highest(curve: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The highest peaks of curves (..., n), the highest first.

    Returns:
        Angle of each (..., count) [rad], between the samples as ``find_top`` says, and its sample's value
        (..., count), -inf where a curve has fewer peaks.
    """
    before, after = np.roll(curve, 1, axis=-1), np.roll(curve, -1, axis=-1)
    peaks = np.where((curve > before) & (curve >= after), curve, -np.inf)
    angle, height = np.empty((*curve.shape[:-1], count)), np.empty((*curve.shape[:-1], count))
    for number in range(count):
        place = peaks.argmax(axis=-1)[..., None]
        height[..., number] = np.take_along_axis(peaks, place, axis=-1)[..., 0]
        low, top, high = (np.take_along_axis(one, place, axis=-1)[..., 0] for one in (before, curve, after))
        angle[..., number] = 2.0 * np.pi / curve.shape[-1] * (place[..., 0] + find_top(low, top, high))
        np.put_along_axis(peaks, place, -np.inf, axis=-1)
    return angle, height


def find_top(low: np.ndarray, top: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Where the parabola through three neighbouring samples has its top, from the middle one [samples]; 0: nowhere."""
    bend = low - 2.0 * top + high
    return np.where(bend < 0.0, (low - high) / (2.0 * np.where(bend < 0.0, bend, -1.0)), 0.0)
