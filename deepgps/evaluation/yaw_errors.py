"""Errors of the yaw that a method estimates from a single image."""

from dataclasses import replace

import numpy as np

from deepgps.evaluation.error_field import ErrorField, find_rms
from deepgps.positioner.pose import Poses
from sim.alignment import Alignment


def add_yaws(field: ErrorField, poses: Poses, alignment: Alignment) -> ErrorField:
    """The error field with yaws, aligned as positions are; the same field where the method estimates no yaw.

    Args:
        field: The field of a method's positions.
        poses: Its poses of the test images (C * H), in the method's frame.
        alignment: From the method's frame to the world's.
    """
    if poses.yaw is None or poses.yaw_std is None or poses.yaw_weight is None:
        return field
    yaw, std, weight = (
        part.reshape(field.predicted.shape[:2]) for part in (poses.yaw, poses.yaw_std, poses.yaw_weight)
    )
    return replace(field, yaw=alignment.turn(yaw), yaw_std=std, yaw_weight=weight)


def summarise_yaw(field: ErrorField) -> dict[str, float]:
    """RMS, median and 95th percentile of the yaw's error [deg] over all images, and RMS over those accepted.

    Empty where there is no yaw; without the last where the method accepts or refuses nothing.
    """
    if field.yaw_error is None or not (known := np.isfinite(field.yaw_error)).any():
        return {}
    error = np.degrees(np.abs(field.yaw_error))
    median, p95 = (float(value) for value in np.percentile(error[known], [50, 95]))
    figures = {"yaw_rms_deg": find_rms(error[known]), "yaw_median_deg": median, "yaw_p95_deg": p95}
    if field.accepted is not None and (accepted := known & field.accepted).any():
        figures["yaw_rms_accepted_deg"] = find_rms(error[accepted])
    return figures
