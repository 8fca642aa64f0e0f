"""Predicted yaws: at each predicted position, an arrow in the direction in which the robot is predicted to look."""

import numpy as np
import pyarrow as pa
import rerun as rr

from deepgps.evaluation.error_field import ErrorField
from deepgps.viewer.error_field import HEIGHT_M, draw_arrows, find_thinness
from deepgps.viewer.scene import LAYER_M, put

LENGTH_M = 0.07
WRONG_DEG = 5.0
GOOD, WRONG = (235, 235, 235), (255, 60, 220)
"""Colours of yaws that are off by at most ``WRONG_DEG``, and of others; the error field's colours mean positions."""


def list_yaws(name: str, field: ErrorField, root: str = "world") -> list[str]:
    """The entity of a method's yaws; empty if it predicts none, or their errors are unknown."""
    return [] if field.yaw is None or field.yaw_error is None else [f"{root}/error_field/{name}/yaw"]


def log_yaws(stream: rr.RecordingStream, name: str, field: ErrorField) -> None:
    """Log the yaws of a method that predicts some, at the heading with the largest error in position."""
    if field.yaw is None or field.yaw_error is None:
        return
    rows = np.arange(len(field.truth)), field.error.argmax(axis=1)
    place, yaw, error = field.predicted[rows], field.yaw[rows], np.degrees(field.yaw_error[rows])
    place, yaw, error = (part[np.isfinite(yaw)] for part in (place, yaw, error))
    tips = place + LENGTH_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    radius = 0.005 * find_thinness(field.truth)
    wrong = np.abs(error) > WRONG_DEG
    [path] = list_yaws(name, field)
    for part, chosen, colour in (("above_5_deg", wrong, WRONG), ("below_5_deg", ~wrong, GOOD)):
        lines = draw_arrows(place[chosen], tips[chosen], HEIGHT_M + LAYER_M)
        said = [
            f"{np.degrees(one):.1f}°, off by {off:.1f}°" for one, off in zip(yaw[chosen], error[chosen], strict=True)
        ]
        put(stream, f"{path}/{part}", rr.LineStrips3D(lines, radii=radius, colors=[colour]))
        put(stream, f"{path}/{part}", rr.AnyValues(yaw=pa.array(said, pa.utf8())))
