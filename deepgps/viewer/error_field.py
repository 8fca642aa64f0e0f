"""Error fields: an arrow from each true place to the predicted one, a dot at the true one, and its numbers.

The viewer's tooltip lists up to three components that differ between the arrows of an entity, and more only by their
number. So an entity has its shape, its colours and one short text, and other values are logged above it.
"""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import rerun as rr
from matplotlib.colors import to_rgb

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField, WorstField, find_worst, split_by_acceptance
from deepgps.reports.field_plot import REFUSED, colours_of
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import Rows, put

LARGE_M = 0.1
PARTS = ("above_10_cm", "below_10_cm")
"""Entities of the worst accepted headings: switching the second one off leaves the large errors."""
REFUSED_PART = "refused"
"""Entity of the worst refused headings, in grey."""
DENSE_M = 0.05  # test positions with smaller spacing get thinner arrows
HEIGHT_M = 3 * LAYER_M  # high enough for coverage and density to be drawn below
HEAD_M = 0.05
HEAD_SHARE = 0.35
"""Length of an arrow's head, at most ``HEAD_M``, as a share of the arrow's."""
NO_PLACES = ErrorField(np.zeros((0, 2)), np.zeros(1), np.zeros((0, 1, 2)))


def log_field(stream: rr.RecordingStream, name: str, field: ErrorField, at: Rows = (), root: str = "world") -> None:
    """Log a method's errors at the worst heading of each place: large, small and refused ones as separate entities."""
    path, thin = f"{root}/error_field/{name}", find_thinness(field.truth)
    accepted, refused = split_by_acceptance(field)
    large = accepted.error > LARGE_M
    for part, chosen in zip(PARTS, (large, ~large), strict=True):
        some = accepted.take(chosen)
        _log_arrows(stream, f"{path}/worst/{part}", name, some, colours_of(some.error), describe_errors(some), thin, at)
    grey = np.array([[*(round(255 * one) for one in to_rgb(REFUSED)), 255]], np.uint8)
    said = [f"refused: {one}" for one in describe_errors(refused)]
    _log_arrows(stream, f"{path}/worst/{REFUSED_PART}", name, refused, grey, said, thin, at)
    if not at:
        put(stream, path, _list_values(find_worst(field)))


def log_headings(stream: rr.RecordingStream, name: str, field: ErrorField) -> None:
    """Log a method's errors at each heading that all places share, if there are several."""
    for number, path in enumerate(list_headings(name, field)):
        chosen = np.zeros(field.predicted.shape[:2], bool)
        chosen[:, number] = True
        one = find_worst(field, chosen)
        words = np.where(field.is_accepted[:, number], "", "refused: ")
        said = [f"{word}{error}" for word, error in zip(words, describe_errors(one), strict=True)]
        _log_arrows(stream, path, name, one, colours_of(one.error), said, find_thinness(field.truth))


def list_headings(name: str, field: ErrorField) -> list[str]:
    """Entities of a method's errors at each heading; empty if places have headings of their own, or only one."""
    if field.heading.ndim != 1 or len(field.heading) < 2:
        return []
    return [f"world/error_field/{name}/heading/{_degrees(one):03.0f}_deg" for one in field.heading]


def describe_errors(field: WorstField) -> list[str]:
    """Error, radius, heading and predicted position of each place, short enough for one line of a tooltip."""
    rows = zip(100 * field.error, _degrees(field.heading), *field.predicted.T, strict=True)
    radius = [""] * len(field.error) if field.radius is None else [f" (± {100 * one:.1f})" for one in field.radius]
    return [
        f"{error:.1f}{within} cm, {heading:.0f}° → {x:z.2f}, {y:z.2f}"
        for within, (error, heading, x, y) in zip(radius, rows, strict=True)
    ]


def draw_arrows(origins: np.ndarray, tips: np.ndarray, z: float = HEIGHT_M) -> np.ndarray:
    """Draw arrows between places (n, 2) [m] as lines (n, 5, 3) that lie flat at height ``z`` [m]."""
    vector = tips - origins
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    head = np.minimum(HEAD_SHARE, HEAD_M / np.maximum(length, 1e-9)) * vector
    side = 0.5 * np.stack([-head[:, 1], head[:, 0]], axis=1)
    corners = [origins, tips, tips - head + side, tips, tips - head - side]
    return np.stack([lift(corner, z) for corner in corners], axis=1)


def find_thinness(places: np.ndarray) -> float:
    """Factor for the thickness of arrows at places (N, 2) [m]; one if there is room for them."""
    area = np.prod(np.ptp(places, axis=0)) if len(places) else 0.0
    return min(1.0, float(np.sqrt(area / len(places))) / DENSE_M) if area > 0 else 1.0


def _log_arrows(
    stream: rr.RecordingStream,
    path: str,
    name: str,
    field: WorstField,
    colours: np.ndarray,
    said: Sequence[str],
    thin: float,
    at: Rows = (),
) -> None:
    """Log arrows and dots in these colours (n or 1, 4), each with what is said of it in its tooltip."""
    words = rr.AnyValues(error=pa.array(said, pa.utf8()), method=[title_of(name)])
    lines = rr.LineStrips3D(draw_arrows(field.truth, field.predicted), radii=0.007 * thin, colors=colours)
    dots = rr.Points3D(lift(field.truth, HEIGHT_M), radii=0.018 * thin, colors=colours, point_shading="Flat")
    for below, shape in (("arrows", lines), ("places", dots)):
        put(stream, f"{path}/{below}", shape, at)
        put(stream, f"{path}/{below}", words, at)


def _list_values(field: WorstField) -> rr.AnyValues:
    return rr.AnyValues(
        x_m=field.truth[:, 0],
        y_m=field.truth[:, 1],
        predicted_x_m=field.predicted[:, 0],
        predicted_y_m=field.predicted[:, 1],
        error_m=field.error,
        heading_deg=_degrees(field.heading),
    )


def _degrees(heading: np.ndarray) -> np.ndarray:
    return np.round(np.degrees(heading)) % 360
