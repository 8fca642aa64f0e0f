"""Layers on the plan of an error field, hidden at first: headings, yaws, radii, expected errors, coverage by images."""

import numpy as np
import pyarrow as pa
import rerun as rr
from matplotlib import colormaps
from scipy.spatial import KDTree

from deepgps.evaluation.error_field import ErrorField, split_by_acceptance
from deepgps.evaluation.measures import find_seen
from deepgps.reports.field_plot import colours_of
from deepgps.viewer.error_field import HEIGHT_M, draw_arrows, find_thinness, list_headings, log_headings
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import put
from sim.occupancy import FreeSpace

YAW_M = 0.07
"""Length of a yaw's arrow [m]."""
WRONG_DEG = 5.0
GOOD, WRONG = (235, 235, 235), (255, 60, 220)
"""Colours of yaws that are off by at most ``WRONG_DEG``, and of others; the error field's colours mean positions."""
CIRCLE_POINTS = 49
COVERAGE, DENSITY = "world/not_covered", "world/images_per_cell"
CELL_M = 0.25
UNSEEN = (232, 37, 79)


def list_layers(name: str, field: ErrorField) -> list[str]:
    """Entities of the layers that a method has: errors at each heading, yaws, radii, errors that its map expects."""
    has = {
        "yaw": field.yaw is not None and field.yaw_error is not None,
        "radius": field.radius is not None,
        "expected": field.expected is not None,
    }
    return [*list_headings(name, field), *(name_layer(name, layer) for layer in has if has[layer])]


def name_layer(name: str, layer: str) -> str:
    """The entity of a method's layer ``yaw``, ``radius`` or ``expected``."""
    return f"world/error_field/{name}/{layer}"


def log_layers(stream: rr.RecordingStream, name: str, field: ErrorField) -> None:
    """Log the layers that a method has."""
    log_headings(stream, name, field)
    _log_yaws(stream, name_layer(name, "yaw"), field)
    _log_radii(stream, name_layer(name, "radius"), field)
    _log_expected(stream, name_layer(name, "expected"), field)


def log_coverage(stream: rr.RecordingStream, place: np.ndarray, space: FreeSpace) -> None:
    """Log the reachable floor too far from every training image, and the number of images in each cell.

    Args:
        stream: The recording.
        place: True positions of the training images (n, 2) [m].
        space: Where the robot fits.
    """
    row, column = np.nonzero(space.reachable)
    floor = space.origin + np.stack([column, row], axis=1) * space.cell_m
    unseen = floor[~find_seen(floor, place)]
    put(stream, COVERAGE, _make_tiles(unseen, space.cell_m, 2 * LAYER_M, np.array([UNSEEN], np.uint8)))
    cell, count = np.unique(np.floor(place / CELL_M).astype(int), axis=0, return_counts=True)
    colours = colormaps["viridis"](np.log(count) / max(np.log(count.max()), 1e-9))[:, :3]
    tiles = _make_tiles((cell + 0.5) * CELL_M, 0.94 * CELL_M, 1.5 * LAYER_M, (255 * colours).astype(np.uint8))
    stream.log(DENSITY, tiles, rr.AnyValues(images=count), static=True)


def draw_circles(centre: np.ndarray, radius: np.ndarray, z: float) -> np.ndarray:
    """Circles around places (n, 2) [m] with radii (n,) [m], as closed lines (n, CIRCLE_POINTS, 3) at height z [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = centre[:, None] + radius[:, None, None] * circle
    return lift(points.reshape(-1, 2), z).reshape(len(centre), CIRCLE_POINTS, 3)


def _log_yaws(stream: rr.RecordingStream, path: str, field: ErrorField) -> None:
    """Log arrows in the predicted directions, at the heading with the largest error in position."""
    if field.yaw is None or field.yaw_error is None:
        return
    rows = np.arange(len(field.truth)), field.error.argmax(axis=1)
    place, yaw, error = field.predicted[rows], field.yaw[rows], np.degrees(field.yaw_error[rows])
    place, yaw, error = (part[np.isfinite(yaw)] for part in (place, yaw, error))
    tips = place + YAW_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    radius = 0.005 * find_thinness(field.truth)
    wrong = np.abs(error) > WRONG_DEG
    for part, chosen, colour in (("above_5_deg", wrong, WRONG), ("below_5_deg", ~wrong, GOOD)):
        lines = draw_arrows(place[chosen], tips[chosen], HEIGHT_M + LAYER_M)
        rows = zip(np.degrees(yaw[chosen]), error[chosen], strict=True)
        words = [f"{one:.1f}°, off by {off:.1f}°" for one, off in rows]
        put(stream, f"{path}/{part}", rr.LineStrips3D(lines, radii=radius, colors=[colour]))
        put(stream, f"{path}/{part}", rr.AnyValues(yaw=pa.array(words, pa.utf8())))


def _log_radii(stream: rr.RecordingStream, path: str, field: ErrorField) -> None:
    """Log the circles that should hold the true positions with a probability of 68 %, in the colours of such errors.

    They are those at the worst accepted heading of each place.
    """
    worst = split_by_acceptance(field)[0]
    if worst.radius is None:
        return
    circles = draw_circles(worst.predicted, worst.radius, HEIGHT_M + LAYER_M)
    rows = zip(100 * worst.radius, 100 * worst.error, strict=True)
    words = [f"68 % within {radius:.1f} cm, off by {error:.1f} cm" for radius, error in rows]
    thickness = 0.003 * find_thinness(field.truth)
    put(stream, path, rr.LineStrips3D(circles, radii=thickness, colors=colours_of(worst.radius)))
    put(stream, path, rr.AnyValues(radius=pa.array(words, pa.utf8())))


def _log_expected(stream: rr.RecordingStream, path: str, field: ErrorField) -> None:
    """Log the error that the initial map expects at each test position, in the colours of the error field."""
    if field.expected is None:
        return
    apart = KDTree(field.truth).query(field.truth, min(2, len(field.truth)))[0].reshape(len(field.truth), -1)[:, -1]
    words = [f"{100 * one:.2f} cm expected" for one in field.expected]
    put(stream, path, _make_tiles(field.truth, float(np.median(apart)), 2 * LAYER_M, colours_of(field.expected)))
    put(stream, path, rr.AnyValues(expected=pa.array(words, pa.utf8())))


def _make_tiles(middle: np.ndarray, size_m: float, height_m: float, colours: np.ndarray) -> rr.Boxes3D:
    """Flat squares around points (n, 2) [m], high enough above the floor plan for the viewer to draw them over it."""
    return rr.Boxes3D(
        centers=lift(middle, height_m),
        half_sizes=[(size_m / 2, size_m / 2, 0.0005)],
        colors=colours,
        fill_mode="solid",
    )
