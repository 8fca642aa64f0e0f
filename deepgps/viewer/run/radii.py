"""Radii: around a predicted position, the circle that should hold the true position with a probability of 68 %."""

import numpy as np
import pyarrow as pa
import rerun as rr

from deepgps.evaluation.error_field import ErrorField, split_by_acceptance
from deepgps.reports.field_plot import colours_of
from deepgps.viewer.error_field import HEIGHT_M, find_thinness
from deepgps.viewer.scene import LAYER_M, lift, put

POINTS = 49


def list_radii(name: str, field: ErrorField, root: str = "world") -> list[str]:
    """The entity of a method's radii; empty if it gives none."""
    return [] if field.radius is None else [f"{root}/error_field/{name}/radius"]


def log_radii(stream: rr.RecordingStream, name: str, field: ErrorField) -> None:
    """Log the circles at the worst accepted heading of each place, in the colours that errors of this size have."""
    worst = split_by_acceptance(field)[0]
    if worst.radius is None:
        return
    [path] = list_radii(name, field)
    circles = draw_circles(worst.predicted, worst.radius, HEIGHT_M + LAYER_M)
    rows = zip(100 * worst.radius, 100 * worst.error, strict=True)
    said = [f"68 % within {radius:.1f} cm, off by {error:.1f} cm" for radius, error in rows]
    thickness = 0.003 * find_thinness(field.truth)
    put(stream, path, rr.LineStrips3D(circles, radii=thickness, colors=colours_of(worst.radius)))
    put(stream, path, rr.AnyValues(radius=pa.array(said, pa.utf8())))


def draw_circles(centre: np.ndarray, radius: np.ndarray, z: float) -> np.ndarray:
    """Circles around places (n, 2) [m] with radii (n,) [m] as closed lines (n, POINTS, 3) at height ``z`` [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = centre[:, None] + radius[:, None, None] * circle
    return lift(points.reshape(-1, 2), z).reshape(len(centre), POINTS, 3)
