"""Error fields: an arrow from each true place to the predicted one, a dot at the true one, and its numbers.

Layers above it are hidden at first: headings, yaws, radii, ellipses, coverage by images.

The viewer's tooltip lists up to three components that differ between the arrows of an entity, and more only by their
number. So an entity has its shape, its colours and one short text, and other values are logged above it.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import rerun as rr
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from scipy.spatial import KDTree

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField, WorstField, find_worst, split_by_acceptance
from deepgps.evaluation.measures import find_seen
from deepgps.positioner import registration
from deepgps.reports.plots import REFUSED_COLOUR, colours_of
from deepgps.viewer.read import COLUMNS
from deepgps.viewer.scene import LAYER_M, draw_ellipses, lift
from deepgps.viewer.stream import Rows, put
from sim.geometry import FreeSpace

LARGE_ERROR_M = 0.1
PARTS = ("above_10_cm", "below_10_cm")
"""Entities of the worst accepted headings: switching the second one off leaves the large errors."""
REFUSED_PART = "refused"  # Entity of the worst refused headings, in grey
DENSE_SPACING_M = 0.05  # test positions with smaller spacing get thinner arrows
HEIGHT_M = 3 * LAYER_M  # high enough for coverage and density to be drawn below
HEAD_M = 0.05
HEAD_SHARE = 0.35  # Length of an arrow's head, at most ``HEAD_M``, as a share of the arrow's
YAW_M = 0.07  # Length of a yaw's arrow [m]
LARGE_YAW_ERROR_DEG = 5.0
GOOD_COLOUR, WRONG_COLOUR = (235, 235, 235), (255, 60, 220)
"""Colours of yaws that are off by at most ``LARGE_YAW_ERROR_DEG``, and of others; the error field's colours mean
positions."""
SIGMA, SIGMA_TICKS_M = "radius_by_place", (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
ELLIPSES, ELLIPSE_SCALE, ELLIPSE_SPACING_M, MAX_ELLIPSES, MAX_RADIUS_M = "ellipses_5_times", 5, 0.2, 1_000, 0.05
"""Layer, how many times larger they are drawn, distance between two [m], most of them, and the largest radius [m]."""
COVERAGE, DENSITY = "world/not_covered", "world/images_per_cell"
CELL_M = 0.25
UNSEEN_COLOUR = (232, 37, 79)
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
    """Log a method's errors at the worst heading of each place: large, small and refused ones as separate entities.

    Marks by the number of a place are added to what its tooltip says.
    """
    path, thin = f"{root}/error_field/{name}", find_thinness(field.truth)
    accepted, refused = split_by_acceptance(field)
    large = accepted.error > LARGE_ERROR_M
    for part, chosen in zip(PARTS, (large, ~large), strict=True):
        some = accepted.take(chosen)
        _log_arrows(
            stream, f"{path}/worst/{part}", name, some, colours_of(some.error), describe_errors(some, marks), thin, at
        )
    said = [f"refused: {one}" for one in describe_errors(refused, marks)]
    _log_arrows(stream, f"{path}/worst/{REFUSED_PART}", name, refused, REFUSED_RGBA[None], said, thin, at)
    if not at:
        worst = find_worst(field)
        columns = np.column_stack([worst.truth, worst.predicted, worst.error, _degrees(worst.heading)]).T
        put(stream, path, rr.AnyValues(**dict(zip(COLUMNS, columns, strict=True))))


def describe_errors(field: WorstField, marks: Mapping[int, str] = MappingProxyType({})) -> list[str]:
    """Error, radius, heading, predicted position and mark of each place, short enough for one line of a tooltip."""
    mark = [marks.get(cell, "") for cell in np.asarray(field.row)[:, 0].tolist()]
    rows = zip(100 * field.error, _degrees(field.heading), *field.predicted.T, mark, strict=True)
    radius = [""] * len(field.error) if field.radius is None else [f" (± {100 * one:.1f})" for one in field.radius]
    return [
        f"{error:.1f}{within} cm, {heading:.0f}° → {x:z.2f}, {y:z.2f}{more}"
        for within, (error, heading, x, y, more) in zip(radius, rows, strict=True)
    ]


def list_layers(name: str, field: ErrorField) -> list[str]:
    """Entities of the layers that a method has: errors at each heading, yaws, radii by place, ellipses."""
    has = {"yaw": field.yaw, SIGMA: field.radius, ELLIPSES: field.covariance}
    layers = [layer for layer, part in has.items() if part is not None]
    return [*_list_headings(name, field), *(name_layer(name, layer) for layer in layers)]


def name_layer(name: str, layer: str) -> str:
    """The entity of a method's layer, such as ``yaw``."""
    return f"world/error_field/{name}/{layer}"


def log_layers(stream: rr.RecordingStream, name: str, field: ErrorField) -> None:
    """Log the layers that a method has."""
    for number, path in enumerate(_list_headings(name, field)):
        chosen = np.zeros(field.predicted.shape[:2], bool)
        chosen[:, number] = True
        one = find_worst(field, chosen)
        words = np.where(field.is_accepted[:, number], "", "refused: ")
        said = [f"{word}{error}" for word, error in zip(words, describe_errors(one), strict=True)]
        _log_arrows(stream, path, name, one, colours_of(one.error), said, find_thinness(field.truth))
    for layer, what, shape, words in _draw_layers(field):
        put(stream, name_layer(name, layer), shape, said={what: words})


def _list_headings(name: str, field: ErrorField) -> list[str]:
    """Entities of a method's errors at each heading; empty if places have headings of their own, or only one."""
    if field.heading.ndim != 1 or len(field.heading) < 2:
        return []
    return [name_layer(name, f"heading/{_degrees(one):03.0f}_deg") for one in field.heading]


Layer = tuple[str, str, rr.AsComponents, list[str]]
"""Entity below the method's, what its tooltip says, shapes, and that text for each shape."""


def _draw_layers(field: ErrorField) -> Iterator[Layer]:
    thin, height_m = find_thinness(field.truth), HEIGHT_M + LAYER_M
    if field.yaw is not None and field.yaw_error is not None:
        yield from _draw_yaws(field, field.yaw, np.degrees(field.yaw_error), 0.005 * thin, height_m)
    worst = split_by_acceptance(field)[0]
    if field.radius is not None:
        sigma = np.where(field.is_accepted, field.radius, 0.0).max(axis=1)
        colours = np.where(sigma[:, None] > 0.0, colours_of(sigma, (SIGMA_TICKS_M[0], SIGMA_TICKS_M[-1])), REFUSED_RGBA)
        words = [f"68 % within {100 * one:.1f} cm" if one else "refused at all headings" for one in sigma]
        yield SIGMA, "radius", _tile_places(field.truth, colours), words
    if field.covariance is not None and field.radius_95 is not None:
        some = np.unique(registration.thin(worst.predicted[None], MAX_ELLIPSES, ELLIPSE_SPACING_M))
        some = some[field.radius_95[tuple(np.asarray(worst.row)[some].T)] <= MAX_RADIUS_M]  # larger ones hide all else
        rows = tuple(np.asarray(worst.row)[some].T)
        # The shape is that of the covariance; the size is that of the radius, which is measured on images left out.
        shape, radius = field.covariance[rows].astype(float), field.radius_95[rows]
        covariance = shape * (2.0 * radius**2 / np.trace(shape, axis1=1, axis2=2))[:, None, None]
        strips = draw_ellipses(worst.predicted[some], ELLIPSE_SCALE**2 * covariance, height_m)
        axes = 100.0 * np.sqrt(np.linalg.eigvalsh(covariance))
        words = [f"95 % within ± {long:.1f}, ± {short:.1f} cm" for short, long in axes]
        yield ELLIPSES, "ellipse", rr.LineStrips3D(strips, radii=0.004, colors=[GOOD_COLOUR]), words


def _draw_yaws(
    field: ErrorField, yaw: np.ndarray, error_deg: np.ndarray, radius_m: float, height_m: float
) -> Iterator[Layer]:
    """Arrows in the predicted directions (C, H) [rad], at the heading with the largest error in position."""
    rows = np.arange(len(field.truth)), field.error.argmax(axis=1)
    place, yaw, error = field.predicted[rows], yaw[rows], error_deg[rows]
    known, wrong = np.isfinite(yaw), np.abs(error) > LARGE_YAW_ERROR_DEG
    tips = place + YAW_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    for part, chosen, colour in (
        ("above_5_deg", known & wrong, WRONG_COLOUR),
        ("below_5_deg", known & ~wrong, GOOD_COLOUR),
    ):
        lines = draw_arrows(place[chosen], tips[chosen], height_m)
        pairs = zip(np.degrees(yaw[chosen]), error[chosen], strict=True)
        words = [f"{one:.1f}°, off by {off:.1f}°" for one, off in pairs]
        yield f"yaw/{part}", "yaw", rr.LineStrips3D(lines, radii=radius_m, colors=[colour]), words


def log_coverage(stream: rr.RecordingStream, place: np.ndarray, space: FreeSpace) -> None:
    """Log the floor too far from every training image, and how many of them, at places (n, 2) [m], each cell has."""
    floor = space.places()
    unseen = floor[~find_seen(floor, place)]
    put(stream, COVERAGE, _make_tiles(unseen, space.cell_m, 2 * LAYER_M, np.array([UNSEEN_COLOUR], np.uint8)))
    cell, count = np.unique(np.floor(place / CELL_M).astype(int), axis=0, return_counts=True)
    colours = colormaps["viridis"](np.log(count) / max(np.log(count.max()), 1e-9))[:, :3]
    tiles = _make_tiles((cell + 0.5) * CELL_M, 0.94 * CELL_M, 1.5 * LAYER_M, (255 * colours).astype(np.uint8))
    stream.log(DENSITY, tiles, rr.AnyValues(images=count), static=True)


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
    words = {"error": said, "method": [title_of(name)]}
    lines = rr.LineStrips3D(draw_arrows(field.truth, field.predicted), radii=0.007 * thin, colors=colours)
    dots = rr.Points3D(lift(field.truth, HEIGHT_M), radii=0.018 * thin, colors=colours, point_shading="Flat")
    for below, shape in (("arrows", lines), ("places", dots)):
        put(stream, f"{path}/{below}", shape, at, words)


def _degrees(heading: np.ndarray) -> np.ndarray:
    return np.round(np.degrees(heading)) % 360


def _tile_places(places: np.ndarray, colours: np.ndarray) -> rr.Boxes3D:
    """Flat squares on the floor around places (n, 2) [m], as large as these are apart."""
    apart = KDTree(places).query(places, min(2, len(places)))[0].reshape(len(places), -1)
    return _make_tiles(places, float(np.median(apart[:, -1])), 2 * LAYER_M, colours)


def _make_tiles(middle: np.ndarray, size_m: float, height_m: float, colours: np.ndarray) -> rr.Boxes3D:
    """Flat squares around points (n, 2) [m], high enough above the floor plan for the viewer to draw them over it."""
    return rr.Boxes3D(
        centers=lift(middle, height_m), half_sizes=[(size_m / 2, size_m / 2, 0.0005)], colors=colours, fill_mode="solid"
    )
