"""The worst places of each method: a test image, the training images like it, and where those were taken.

The timelines ``place`` and ``progress`` walk through them and end with the worst of the first method, since the viewer
opens a timeline at its end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from scipy.spatial import KDTree

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField
from deepgps.reports.table import tabulate
from deepgps.viewer.run.alike import find_alike
from deepgps.viewer.run.place_drawing import ALIKE, log_map, log_pictures, log_radii
from deepgps.viewer.timeline import place_index
from sim.recording.format import Recording, Truth

PLACES = 12  # of each method
APART_M = 0.25
LABEL_ABOVE = 0.07  # as a share of the room's depth
IMAGE_COLUMNS = ("image", "x, y [m]", "away [m]", "heading")
NOTE = (
    "Away: from the true position. Alike: most like the test image, at any heading; closest: taken nearest to it. "
    "Training images are turned to the test image's heading.\n\n"
    "Choose the timeline `place` at the bottom and press Ctrl and ← for the next place."
)


@dataclass(frozen=True)
class Place:
    """A test position at which a method fails.

    Attributes:
        method: The method.
        rank: 1 for its worst place.
        cell: Index of the test position.
        heading: Index of its worst heading.
    """

    method: str
    rank: int
    cell: int
    heading: int


def find_places(fields: Mapping[str, ErrorField], count: int = PLACES) -> list[Place]:
    """Find each method's worst places, at least ``APART_M`` apart from one another."""
    places = []
    for method, field in fields.items():
        error = field.error
        order = np.argsort(-error.max(axis=1), kind="stable")
        chosen: list[int] = []
        for cell in order:
            if (
                len(chosen) < count
                and (np.linalg.norm(field.truth[chosen] - field.truth[cell], axis=1) > APART_M).all()
            ):
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
    alike = find_alike(recording, tests, ALIKE)
    cells = [(fields[place.method], place) for place in places]
    true = np.stack([field.truth[place.cell] for field, place in cells])
    predicted = np.stack([field.predicted[place.cell, place.heading] for field, place in cells])
    away, closest = KDTree(truth.pose[:, :2]).query(true)
    shown = np.column_stack([alike, closest])  # indices of training observations
    at = place_index(len(places))
    refused = [not field.is_accepted[place.cell, place.heading] for field, place in cells]
    above_m = LABEL_ABOVE * np.ptp(cells[0][0].truth[:, 1])
    log_map(stream, true, predicted, refused, truth.pose[shown], above_m, at)
    log_radii(stream, predicted, [_radii_at(*one) for one in cells], at)
    texts = {
        "text": [_describe(number, places, fields, float(away[number])) for number in range(len(places))],
        "taken": [_describe_images(*one) for one in zip(true, truth.pose[shown], strict=True)],
    }
    for name, rows in texts.items():
        stream.log(f"place/{name}", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
        stream.send_columns(f"place/{name}", at, rr.TextDocument.columns(text=rows))
    if recording.kind == "polar_image":
        heading = np.array([_headings_at(field, place)[place.heading] for field, place in cells])
        turn = truth.pose[shown, 2] - heading[:, None]
        log_pictures(stream, recording, tests, shown, turn, at)


def _headings_at(field: ErrorField, place: Place) -> np.ndarray:
    """Headings (H,) [rad] of the test observations at a place."""
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
    brackets = (
        " (in brackets: refused)" if any(not one.is_accepted[place.cell].all() for one in fields.values()) else ""
    )
    count = sum(one.method == place.method for one in places)
    error_cm = 100 * field.error[place.cell, place.heading]
    return "\n\n".join(
        [
            f"# {title_of(place.method)}: {error_cm:.1f} cm",
            f"Worst place {place.rank} of {count} of this method; {len(places) - number} on the timeline `place`.",
            f"True position {true[0]:.2f}, {true[1]:.2f} m; predicted {predicted[0]:.2f}, {predicted[1]:.2f} m, "
            f"at heading {heading[place.heading]:.0f}°. The closest training image was taken {away_m:.2f} m away.",
            *_describe_trust(field, place),
            f"Errors here at each heading [cm]{brackets}:",
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
    """Describe in Markdown where the training images (ALIKE + 1, 3) were taken, and how to walk through the places."""
    images = [
        [
            name,
            f"{pose[0]:.2f}, {pose[1]:.2f}",
            f"{np.linalg.norm(pose[:2] - true):.2f}",
            f"{round(np.degrees(pose[2])) % 360}°",
        ]
        for name, pose in zip((*(f"alike {k + 1}" for k in range(ALIKE)), "closest"), taken, strict=True)
    ]
    return "\n\n".join(["Where the training images were taken:", tabulate(IMAGE_COLUMNS, images), NOTE])
