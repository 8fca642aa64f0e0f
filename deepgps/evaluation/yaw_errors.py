"""Errors of the yaw that a method estimates from a single image."""

from dataclasses import replace

import numpy as np

from deepgps.alignment import Alignment
from deepgps.evaluation.error_field import ErrorField
from deepgps.methods.pose import set_upright
from deepgps.methods.positioner import Positioner, headings_of
from sim.recording.format import Recording


def add_yaws(
    field: ErrorField, positioner: Positioner, recording: Recording, positions: np.ndarray, alignment: Alignment
) -> ErrorField:
    """The error field with yaws, aligned as positions are; the same field where the method estimates no yaw.

    Args:
        field: The field of a method's positions.
        positioner: The positioner in use.
        recording: With the test images.
        positions: Predicted positions of these (C, H, 2) [m], in the method's frame.
        alignment: From the method's frame to the world's.
    """
    headings = headings_of(positioner)
    if headings is None:
        return field
    images, shape = recording.test_observation, positions.shape[:2]
    images = set_upright(positioner, images.reshape(-1, *images.shape[2:]))
    found = headings.find(images, positions.reshape(-1, 2))
    yaw, std, weight = (part[:, 0].reshape(shape) for part in (found.yaw, found.std, found.weight))
    return replace(field, yaw=alignment.turn(yaw), yaw_std=std, yaw_weight=weight)


def summarise_yaw(field: ErrorField) -> dict[str, float]:
    """RMS, median and 95th percentile of the yaw's error [deg] over all images; empty where there is no yaw."""
    if field.yaw_error is None or not np.isfinite(field.yaw_error).any():
        return {}
    error = np.degrees(np.abs(field.yaw_error[np.isfinite(field.yaw_error)]))
    median, p95 = (float(value) for value in np.percentile(error, [50, 95]))
    return {"yaw_rms_deg": float(np.sqrt(np.mean(error**2))), "yaw_median_deg": median, "yaw_p95_deg": p95}
