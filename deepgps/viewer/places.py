"""The worst places of each method: a test image, the training images like it, and where those were taken.

The timelines ``place`` and ``progress`` walk through them and end with the worst of the first method, since the viewer
opens a timeline at its end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import rerun as rr
from scipy.spatial import KDTree

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField
from deepgps.positioner.registration import thin
from deepgps.reports.table import tabulate
from deepgps.viewer.drive import camera_of
from deepgps.viewer.error_field import draw_arrows
from deepgps.viewer.pictures import log_views
from deepgps.viewer.scene import LAYER_M, draw_circles, lift
from deepgps.viewer.stream import Shapes, place_rows, send_rows, send_shapes
from sim.recording.format import Recording, Truth
from sim.recording.manifest import ObservationKind

PLACES = 12  # of each method
MIN_SEPARATION_M = 0.25
LABEL_ABOVE = 0.07  # as a share of the room's depth
SIMILAR_IMAGES = 2
PICTURES = ("test", *(f"alike_{number + 1}" for number in range(SIMILAR_IMAGES)), "closest")
COLOURS = {"test": (255, 255, 255), "alike": (255, 196, 60), "closest": (63, 208, 165)}
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
        chosen = order[np.unique(thin(field.truth[None, order], count, MIN_SEPARATION_M))].tolist()
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
    send_shapes(stream, "world/place", at, _draw(cells, true, predicted, taken))
    radii = [_radii_at(*one) for one in cells]
    counts = [len(some) for some in radii]
    circles = draw_circles(np.repeat(predicted, counts, axis=0), np.concatenate([[], *radii]), 5 * LAYER_M)
    send_shapes(stream, "world/place", at, {"radius": ({"strips": circles}, COLOURS["test"], 0.007)}, counts)
    texts = {
        "text": [_describe(number, places, fields, float(away[number])) for number in range(len(places))],
        "taken": [_describe_images(*one) for one in zip(true, taken, strict=True)],
    }
    for name, rows in texts.items():
        send_rows(stream, f"place/{name}", rr.TextDocument, at, {"text": rows}, {"media_type": "text/markdown"})
    if recording.kind == "polar_image":
        heading = np.array([_headings_at(field, place)[place.heading] for field, place in cells])
        log_views(stream, "place/test", tests, camera_of(recording), at)
        for name, numbers, yaw in zip(PICTURES[1:], shown.T, taken[..., 2].T, strict=True):
            turned = np.stack(list(map(turn_picture, recording.observation[numbers], yaw - heading)))
            log_views(stream, f"place/{name}", turned, camera_of(recording), at)


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


def _draw(
    cells: Sequence[tuple[ErrorField, Place]], true: np.ndarray, predicted: np.ndarray, taken: np.ndarray
) -> Shapes:
    """Each place's arrow and label, and dots and headings of the training images (n, SIMILAR_IMAGES + 1, 3) below."""
    labels = [
        f"{100 * error:.1f} cm{'' if field.is_accepted[place.cell, place.heading] else ', refused'}"
        for error, (field, place) in zip(np.linalg.norm(predicted - true, axis=1), cells, strict=True)
    ]
    above = true + [0, LABEL_ABOVE * np.ptp(cells[0][0].truth[:, 1])]  # the viewer draws a label below its point
    shapes: Shapes = {
        "error": ({"strips": draw_arrows(true, predicted, 5 * LAYER_M)}, COLOURS["test"], 0.014),
        "test": ({"positions": lift(true, 6 * LAYER_M)}, COLOURS["test"], 0.03),
        "test/label": ({"positions": lift(above, 6 * LAYER_M), "labels": labels}, COLOURS["test"], 0.0),
    }
    for name, pose in zip(PICTURES[1:], np.swapaxes(taken, 0, 1), strict=True):
        # a training image may be both: the closest one's dot is the larger and the lower
        kind, closest = name.partition("_")[0], name == PICTURES[-1]
        dots, arrows = lift(pose[:, :2], (4 if closest else 6) * LAYER_M), draw_headings(pose, (3 if closest else 5))
        shapes[name] = ({"positions": dots}, COLOURS[kind], 0.05 if closest else 0.03)
        shapes[f"{name}/heading"] = ({"strips": arrows}, COLOURS[kind], 0.014)
        if not closest:
            tips = {"positions": arrows[:, 1] + [0, 0, LAYER_M], "labels": [name.removeprefix("alike_")] * len(pose)}
            shapes[f"{name}/label"] = (tips, COLOURS[kind], 0.0)
    return shapes


def draw_headings(pose: np.ndarray, layer: int) -> np.ndarray:
    """Arrows ahead of poses (n, 3) [m, m, rad] as ``draw_arrows`` draws them, in a layer."""
    ahead = HEADING_M * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    return draw_arrows(pose[:, :2], pose[:, :2] + ahead, layer * LAYER_M)


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
