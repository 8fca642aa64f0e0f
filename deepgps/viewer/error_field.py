"""Error fields: an arrow from each true place to the predicted one, a dot at the true one, and its numbers.

The viewer's tooltip lists up to three components that differ between the arrows of an entity, and more only by their
number. So an entity has its shape, its colours and one short text.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import rerun as rr
from matplotlib.colors import to_rgb
from scipy.spatial import KDTree

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField, WorstField, split_by_acceptance
from deepgps.positioner import registration
from deepgps.reports.plots import REFUSED_COLOUR, colours_of
from deepgps.viewer.scene import LAYER_M, draw_ellipses, lift
from deepgps.viewer.stream import Rows, put

ACCEPTED_PART, REFUSED_PART = (
    "accepted",
    "refused",
)  # Entities of the worst headings that are accepted, and of those refused
DENSE_SPACING_M = 0.05  # test positions with smaller spacing get thinner arrows
HEIGHT_M = 3 * LAYER_M
HEAD_M = 0.05
HEAD_SHARE = 0.35  # Length of an arrow's head, at most ``HEAD_M``, as a share of the arrow's
ELLIPSE_SCALE, ELLIPSE_SPACING_M, MAX_ELLIPSES, MAX_RADIUS_M = 5, 0.2, 1_000, 0.05
"""How many times larger ellipses are drawn, least distance between two [m], most, and the largest radius drawn [m]."""
ELLIPSE_COLOUR = (255, 255, 255)
TRUST, RADIUS_TICKS_M = "world/trust", (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
REFUSED_RGBA = np.array([*(round(255 * one) for one in to_rgb(REFUSED_COLOUR)), 255], np.uint8)
NO_PLACES = ErrorField(np.zeros((0, 2)), np.zeros(1), np.zeros((0, 1, 2)))


def log_field(
    stream: rr.RecordingStream,
    name: str,
    field: ErrorField,
    at: Rows = (),
    root: str = "world",
    marks: Mapping[int, str] = MappingProxyType({}),
) -> None:
    """Log a method's errors at the worst heading of each place: those that it accepts, and in grey those it refuses.

    Marks by the number of a place are added to what its tooltip says.
    """
    accepted, refused = split_by_acceptance(field)
    thin = find_thinness(field.truth)
    for part, some, colours, before in (
        (ACCEPTED_PART, accepted, colours_of(accepted.error), ""),
        (REFUSED_PART, refused, REFUSED_RGBA[None], "refused: "),
    ):
        words = {"error": [before + one for one in describe_errors(some, marks)], "method": [title_of(name)]}
        lines = rr.LineStrips3D(draw_arrows(some.truth, some.predicted), radii=0.007 * thin, colors=colours)
        dots = rr.Points3D(lift(some.truth, HEIGHT_M), radii=0.018 * thin, colors=colours, point_shading="Flat")
        for below, shape in (("arrows", lines), ("places", dots)):
            put(stream, f"{root}/error_field/{name}/{part}/{below}", shape, at, words)


def describe_errors(field: WorstField, marks: Mapping[int, str] = MappingProxyType({})) -> list[str]:
    """Error, radius, heading, predicted position and mark of each place, short enough for one line of a tooltip."""
    mark = [marks.get(cell, "") for cell in np.asarray(field.row)[:, 0].tolist()]
    heading = np.round(np.degrees(field.heading)) % 360
    rows = zip(100 * field.error, heading, *field.predicted.T, mark, strict=True)
    radius = [""] * len(field.error) if field.radius is None else [f" (± {100 * one:.1f})" for one in field.radius]
    return [
        f"{error:.1f}{within} cm, {heading:.0f}° → {x:z.2f}, {y:z.2f}{more}"
        for within, (error, heading, x, y, more) in zip(radius, rows, strict=True)
    ]


def log_trust(stream: rr.RecordingStream, name: str, field: ErrorField) -> None:
    """Log squares around the places in the colours of the largest radius of 68 % that a method accepts there."""
    radius = np.where(field.is_accepted, np.asarray(field.radius), 0.0).max(axis=1)
    colours = colours_of(radius, (RADIUS_TICKS_M[0], RADIUS_TICKS_M[-1]))
    colours = np.where(radius[:, None] > 0.0, colours, REFUSED_RGBA)
    apart = KDTree(field.truth).query(field.truth, min(2, len(field.truth)))[0].reshape(len(field.truth), -1)
    half = float(np.median(apart[:, -1])) / 2
    # high enough above the floor plan for the viewer to draw them over it
    middle = lift(field.truth, 2 * LAYER_M)
    squares = rr.Boxes3D(centers=middle, half_sizes=[(half, half, 0.0005)], colors=colours, fill_mode="solid")
    words = [f"68 % within {100 * one:.1f} cm" if one else "refused at all headings" for one in radius]
    put(stream, f"{TRUST}/{name}/radius", squares, said={"radius": words})
    if field.covariance is not None and field.radius_95 is not None:
        _log_ellipses(stream, f"{TRUST}/{name}/ellipses", field, field.covariance, field.radius_95)


def _log_ellipses(
    stream: rr.RecordingStream, path: str, field: ErrorField, covariance: np.ndarray, radius_95: np.ndarray
) -> None:
    """Log an ellipse of 95 %, enlarged, at some of the accepted predictions, with the shape of their covariance.

    The size is that of the radius, which is measured on images left out.
    """
    worst = split_by_acceptance(field)[0]
    some = np.unique(registration.thin(worst.predicted[None], MAX_ELLIPSES, ELLIPSE_SPACING_M))
    some = some[radius_95[tuple(np.asarray(worst.row)[some].T)] <= MAX_RADIUS_M]  # larger ones hide all else
    rows = tuple(np.asarray(worst.row)[some].T)
    shape, radius = covariance[rows].astype(float), ELLIPSE_SCALE * radius_95[rows]
    spread = shape * (2.0 * radius**2 / np.trace(shape, axis1=1, axis2=2))[:, None, None]
    strips = draw_ellipses(worst.predicted[some], spread, HEIGHT_M)
    put(stream, path, rr.LineStrips3D(strips, radii=0.004, colors=[ELLIPSE_COLOUR]))


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
    return min(1.0, float(np.sqrt(area / len(places))) / DENSE_SPACING_M) if area > 0 else 1.0
