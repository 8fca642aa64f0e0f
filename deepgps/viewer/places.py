"""The worst places of each method: a test image, the training images like it, and where those were taken.

The timelines ``place`` and ``progress`` walk through them and end with the worst of the first method, since the viewer
opens a timeline at its end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import rerun as rr
from scipy.spatial import KDTree

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField
from deepgps.reports.table import tabulate
from deepgps.viewer.drive import camera_of
from deepgps.viewer.error_field import draw_arrows, draw_circles
from deepgps.viewer.pictures import encode_jpeg, enlarge, log_jpegs, make_warp, warp_round
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.stream import Rows, place_rows, send_rows
from sim.recording.format import Recording, Truth
from sim.recording.manifest import ObservationKind

PLACES = 12  # of each method
MIN_SEPARATION_M = 0.25
LABEL_ABOVE = 0.07  # as a share of the room's depth
SIMILAR_IMAGES = 2
PICTURES = ("test", *(f"alike_{number + 1}" for number in range(SIMILAR_IMAGES)), "closest")
COLOURS = {"test": (255, 255, 255), "alike": (255, 196, 60), "closest": (63, 208, 165)}
ROUND_PX, POLAR_ZOOM = 256, 3
HEADING_M = 0.22
MAX_COMPARED = 20_000  # observations; of longer recordings, evenly spread ones
SMALL_ROWS, SMALL_COLUMNS = 8, 64
CHUNK = 1_000
IMAGE_COLUMNS = ("image", "x, y [m]", "away [m]", "heading")
NOTE = (
    "Away: from the true position. Alike: most like the test image, at any heading; closest: taken nearest to it. "
    "Training images are turned to the test image's heading.\n\n"
    "Choose the timeline `place` at the bottom and press Ctrl and ← for the next place."
)


@dataclass(frozen=True)
class Place:
    """A test position at which a method fails."""

    method: str  # The method
    rank: int  # 1 for its worst place
    cell: int  # Index of the test position
    heading: int  # Index of its worst heading


def find_places(fields: Mapping[str, ErrorField], count: int = PLACES) -> list[Place]:
    """Find each method's worst places, at least ``MIN_SEPARATION_M`` apart from one another."""
    places = []
    for method, field in fields.items():
        error = field.error
        order = np.argsort(-error.max(axis=1), kind="stable")
        chosen: list[int] = []
        for cell in order:
            away = np.linalg.norm(field.truth[chosen] - field.truth[cell], axis=1)
            if len(chosen) < count and (away > MIN_SEPARATION_M).all():
                chosen.append(int(cell))
        places += [Place(method, rank + 1, cell, int(error[cell].argmax())) for rank, cell in enumerate(chosen)]
    return places


def log_places(
    stream: rr.RecordingStream,
    fields: Mapping[str, ErrorField],
    places: Sequence[Place],
    recording: Recording,
    truth: Truth,
) -> None:
    """Log for each place its arrow, its numbers, its test image, and the training images alike and closest to it."""
    tests = np.stack([recording.test_observation[place.cell, place.heading] for place in places])
    cells = [(fields[place.method], place) for place in places]
    true = np.stack([field.truth[place.cell] for field, place in cells])
    predicted = np.stack([field.predicted[place.cell, place.heading] for field, place in cells])
    away, closest = KDTree(truth.pose[:, :2]).query(true)
    shown = np.column_stack([find_alike(recording, tests, SIMILAR_IMAGES), closest])  # indices of training observations
    at, taken = place_rows(len(places)), truth.pose[shown]
    _log_arrows(stream, cells, true, predicted, at)
    _log_taken(stream, taken, at)
    radii = [_radii_at(*one) for one in cells]
    counts = [len(some) for some in radii]
    circles = draw_circles(np.repeat(predicted, counts, axis=0), np.concatenate([[], *radii]), 5 * LAYER_M)
    style = {"radii": 0.007, "colors": [COLOURS["test"]]}
    send_rows(stream, "world/place/radius", rr.LineStrips3D, at, {"strips": circles}, style, counts)
    texts = {
        "text": [_describe(number, places, fields, float(away[number])) for number in range(len(places))],
        "taken": [_describe_images(*one) for one in zip(true, taken, strict=True)],
    }
    for name, rows in texts.items():
        send_rows(stream, f"place/{name}", rr.TextDocument, at, {"text": rows}, {"media_type": "text/markdown"})
    if recording.kind == "polar_image":
        heading = np.array([_headings_at(field, place)[place.heading] for field, place in cells])
        _log_pictures(stream, recording, tests, shown, taken[..., 2] - heading[:, None], at)


def _headings_at(field: ErrorField, place: Place) -> np.ndarray:
    return np.broadcast_to(field.heading, field.error.shape)[place.cell]


def _radii_at(field: ErrorField, place: Place) -> list[float]:
    """Radii of 68 and 95 % at a place [m]; empty if the method gives none."""
    return [float(part[place.cell, place.heading]) for part in (field.radius, field.radius_95) if part is not None]


def _describe(number: int, places: Sequence[Place], fields: Mapping[str, ErrorField], away_m: float) -> str:
    """Describe a place in Markdown: its numbers, and what the other methods say there."""
    place = places[number]
    field = fields[place.method]
    true, predicted = field.truth[place.cell], field.predicted[place.cell, place.heading]
    heading = np.degrees(_headings_at(field, place))
    errors = [[title_of(name), *_write_errors(one, place.cell)] for name, one in fields.items()]
    all_accepted = all(one.is_accepted[place.cell].all() for one in fields.values())
    count = sum(one.method == place.method for one in places)
    return "\n\n".join(
        [
            f"# {title_of(place.method)}: {100 * field.error[place.cell, place.heading]:.1f} cm",
            f"Worst place {place.rank} of {count} of this method; {len(places) - number} on the timeline `place`.",
            f"True position {true[0]:.2f}, {true[1]:.2f} m; predicted {predicted[0]:.2f}, {predicted[1]:.2f} m, "
            f"at heading {heading[place.heading]:.0f}°. The closest training image was taken {away_m:.2f} m away.",
            *_describe_trust(field, place),
            f"Errors here at each heading [cm]{'' if all_accepted else ' (in brackets: refused)'}:",
            tabulate(["method", *(f"{one:.0f}°" for one in heading)], errors),
        ]
    )


def _describe_trust(field: ErrorField, place: Place) -> list[str]:
    """Say whether the method accepts the image, and its radii; nothing where it gives neither."""
    words = []
    if field.accepted is not None:
        words.append(f"The method {'accepts' if field.accepted[place.cell, place.heading] else 'refuses'} this image.")
    if radii := _radii_at(field, place):
        inner, outer = (100 * radius for radius in radii)
        words.append(f"It expects the true position within {inner:.1f} cm (68 %) or {outer:.1f} cm (95 %).")
    return [" ".join(words)] if words else []


def _write_errors(field: ErrorField, cell: int) -> list[str]:
    """Errors at each heading of a place [cm], in brackets where the method refuses the image."""
    rows = zip(100 * field.error[cell], field.is_accepted[cell], strict=True)
    return [f"{error:.1f}" if accepted else f"({error:.1f})" for error, accepted in rows]


def _describe_images(true: np.ndarray, taken: np.ndarray) -> str:
    """Say in Markdown where the training images (SIMILAR_IMAGES + 1, 3) were taken, and how to walk through them."""
    away = np.linalg.norm(taken[:, :2] - true, axis=1)
    images = [
        [name.replace("_", " "), f"{x:.2f}, {y:.2f}", f"{one:.2f}", f"{round(np.degrees(yaw)) % 360}°"]
        for name, one, (x, y, yaw) in zip(PICTURES[1:], away, taken, strict=True)
    ]
    return "\n\n".join(["Where the training images were taken:", tabulate(IMAGE_COLUMNS, images), NOTE])


def _log_arrows(
    stream: rr.RecordingStream,
    cells: Sequence[tuple[ErrorField, Place]],
    true: np.ndarray,
    predicted: np.ndarray,
    at: Rows,
) -> None:
    """Log each place's arrow above all others, with a label above it, since the viewer draws one below its point."""
    _log(stream, "error", "test", {"strips": draw_arrows(true, predicted, 5 * LAYER_M)}, at)
    _log(stream, "test", "test", {"positions": lift(true, 6 * LAYER_M)}, at)
    labels = [
        f"{100 * error:.1f} cm{'' if field.is_accepted[place.cell, place.heading] else ', refused'}"
        for error, (field, place) in zip(np.linalg.norm(predicted - true, axis=1), cells, strict=True)
    ]
    above = true + [0, LABEL_ABOVE * np.ptp(cells[0][0].truth[:, 1])]
    _log(stream, "test/label", "test", {"positions": lift(above, 6 * LAYER_M), "labels": labels}, at)


def _log_taken(stream: rr.RecordingStream, taken: np.ndarray, at: Rows) -> None:
    """Log where the training images (n, SIMILAR_IMAGES + 1, 3) were taken, with an arrow in the direction of each."""
    for number, name in enumerate(PICTURES[1:]):
        place, yaw = taken[:, number, :2], taken[:, number, 2]
        # a training image may be both: the closest one's dot is the larger and the lower
        closest = name == PICTURES[-1]
        dots = {"positions": lift(place, (4 if closest else 6) * LAYER_M)}
        _log(stream, name, name, dots, at, 0.05 if closest else 0.03)
        ahead = place + HEADING_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        arrows = draw_arrows(place, ahead, (3 if closest else 5) * LAYER_M)
        _log(stream, f"{name}/heading", name, {"strips": arrows}, at)
        if not closest:
            labels = [name.removeprefix("alike_")] * len(place)
            _log(stream, f"{name}/label", name, {"positions": lift(ahead, 6 * LAYER_M), "labels": labels}, at)


def _log(
    stream: rr.RecordingStream, entity: str, name: str, rows: Mapping[str, Any], at: Rows, radius_m: float = 0.03
) -> None:
    """Log lines, labels or dots in the colour of a picture."""
    style: dict[str, Any] = {"radii": radius_m, "colors": [COLOURS[name.partition("_")[0]]], "point_shading": "Flat"}
    if "strips" in rows:
        style = {"radii": 0.014, "colors": style["colors"]}
    elif "labels" in rows:
        style = {"radii": 0.0, "colors": style["colors"], "show_labels": True}
    kind = rr.LineStrips3D if "strips" in rows else rr.Points3D
    send_rows(stream, f"world/place/{entity}", kind, at, rows, style)


def _log_pictures(
    stream: rr.RecordingStream,
    recording: Recording,
    tests: np.ndarray,
    shown: np.ndarray,
    turn: np.ndarray,
    at: Rows,
) -> None:
    """Log test images (n, rings, sectors, 3) and training images ``shown``, polar and as round pictures.

    Training images are turned by angles (n, SIMILAR_IMAGES + 1) [rad] to the test image's heading.
    """
    rings, sectors = recording.observation.shape[1:3]
    warp = make_warp(camera_of(recording), rings, sectors, ROUND_PX)
    images = {"test": list(tests)}
    for name, numbers, angles in zip(PICTURES[1:], shown.T, turn.T, strict=True):
        rows = zip(recording.observation[numbers], angles, strict=True)
        images[name] = [turn_picture(image, angle) for image, angle in rows]
    for name, polar in images.items():
        log_jpegs(stream, f"place/{name}/polar", (encode_jpeg(enlarge(image, POLAR_ZOOM)) for image in polar), at)
        log_jpegs(stream, f"place/{name}/round", (encode_jpeg(warp_round(image, warp)) for image in polar), at)


def turn_picture(polar: np.ndarray, angle: float) -> np.ndarray:
    """Turn a polar image (rings, sectors, ...) counter-clockwise by an angle [rad], to the nearest sector."""
    return np.roll(polar, round(angle / (2 * np.pi) * polar.shape[1]), axis=1)


def find_alike(recording: Recording, tests: np.ndarray, count: int) -> np.ndarray:
    """Indices (T, count) of the training observations most like each of T test observations, the most alike first.

    Polar images and scans are compared at every turn: the squared difference follows from a circular correlation.
    """
    every = -(-len(recording.observation) // MAX_COMPARED)
    wanted = _shrink(tests, recording.kind)
    parts = []
    for first in range(0, len(recording.observation), CHUNK * every):
        known = _shrink(recording.observation[first : first + CHUNK * every : every], recording.kind)
        parts.append(_compare(wanted, known))
    return every * np.argsort(np.concatenate(parts, axis=1), axis=1, kind="stable")[:, :count]


def _shrink(observations: np.ndarray, kind: ObservationKind | None) -> np.ndarray:
    """Observations as small arrays (n, rows, columns) that turn along their columns; vectors have one column."""
    values = np.asarray(observations)
    if kind == "polar_image":
        pictures = [cv2.resize(image, (SMALL_COLUMNS, SMALL_ROWS), interpolation=cv2.INTER_AREA) for image in values]
        values = np.moveaxis(np.stack(pictures), 3, 1).reshape(len(values), -1, SMALL_COLUMNS)
    elif kind != "scan":
        values = values.reshape(len(values), -1, 1)
    return np.nan_to_num(values.astype(np.float32))


def _compare(wanted: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Least squared difference (T, n), up to a constant, between T and n small arrays over all turns."""
    columns = known.shape[2]
    spectra, power = np.fft.rfft(known).conj(), (known**2).sum(axis=(1, 2))
    products = (np.einsum("rf,nrf->nf", np.fft.rfft(one), spectra) for one in wanted)
    return np.stack([power - 2 * np.fft.irfft(product, n=columns).max(axis=1) for product in products])
