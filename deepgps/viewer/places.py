"""The worst places of each method, one by one.

Each image is shown beside the training images against which it was registered, with its modes and the pixels that
differ. The timeline ``place`` walks through them from the worst of the first method on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
from scipy.spatial import KDTree

from deepgps.config.methods import folder_of, title_of
from deepgps.evaluation.deployment import adapt, open_deployment
from deepgps.evaluation.error_field import ErrorField, find_worst
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.positioner.kriging import NEIGHBOURS, find_nearest
from deepgps.positioner.pixels import grey
from deepgps.positioner.positioner import FeaturePositioner, RegistrationPositioner
from deepgps.positioner.registration import thin
from deepgps.positioner.stored_positioner import is_finished, load_positioner
from deepgps.reports.table import tabulate
from deepgps.viewer.drive import camera_of
from deepgps.viewer.error_field import draw_arrows
from deepgps.viewer.pictures import log_round
from deepgps.viewer.scene import LABEL_COLOUR, LAYER_M, draw_circles, lift
from deepgps.viewer.stream import PLACE, Rows, Shapes, find_span, send_rows, send_shapes, start_row
from sim.recording.format import Recording, Truth

PLACES, OTHERS = 40, 12  # Worst places of the first method, and of each other
MIN_SEPARATION_M = 0.25
MIN_PROBABILITY = 1e-3  # Of modes that are drawn
LABEL_ABOVE = 0.07  # as a share of the room's depth
ANSWER_IMAGES = 2
TRAINING_IMAGES = (*(f"answer_{number + 1}" for number in range(ANSWER_IMAGES)), "closest")
PICTURES = ("test", "weight", *TRAINING_IMAGES)
COLOURS = {"test": (255, 255, 255), "answer": (255, 196, 60), "closest": (63, 208, 165)}
OTHER_COLOUR, MARK = (225, 85, 20), np.array([255, 0, 200])
HEADING_M = 0.22
IMAGE_COLUMNS = ("training image", "x, y [m]", "away [m]", "heading")
WORDS = ("accepted", "unlike all seen near by", "another place looks the same", "two answers contradict each other")
NOTE = (
    "Away: from the true position. Yellow: training images around the answer, against which registration compares, "
    "turned to the heading that it finds; green: the one taken nearest, turned to the true heading. Orange: places "
    "that explain the image, with probabilities. Magenta: pixels that are not as predicted at the likeliest place.\n\n"
    "Choose the timeline `place` at the bottom and press Ctrl and → for the next place."
)


class Look(NamedTuple):
    """What registration says of an image."""

    mode: np.ndarray  # Places that explain it, the likeliest first, in the world (k, 2) [m]; NaN: there is none
    probability: np.ndarray  # Of each (k,)
    unlike: float  # Its squared residual over the largest that is usual
    weight: np.ndarray | None  # Weight of each pixel (R, S), 1 where it agrees; None: pixels are not compared
    near: np.ndarray | None  # Training images that it is compared with; None: they are not numbered


@dataclass(frozen=True)
class Place:
    """An image that is shown."""

    method: str  # The method that locates it
    field: ErrorField  # The method's errors
    at: tuple[int, int]  # The numbers of its position and of its heading there
    image: np.ndarray  # The observation
    rank: str  # What number it is of how many
    look: Look | None = None  # What registration says of it; None: nothing

    @property
    def headings(self) -> np.ndarray:
        """Headings at its position (H,) [rad]."""
        return np.broadcast_to(self.field.heading, self.field.error.shape)[self.at[0]]

    @property
    def pose(self) -> np.ndarray:
        """Its true x, y [m], heading [rad] (3,)."""
        return np.append(self.field.truth[self.at[0]], self.headings[self.at[1]])

    @property
    def yaw(self) -> float:
        """The heading that the method finds, or else the true one [rad]."""
        found = np.nan if self.field.yaw is None else self.field.yaw[self.at]
        return float(found if np.isfinite(found) else self.pose[2])

    @property
    def radii(self) -> list[float]:
        """Radii of 68 and 95 % [m]; empty if it is refused, or if the method gives none."""
        parts = (self.field.radius, self.field.radius_95) if self.field.is_accepted[self.at] else ()
        return [float(part[self.at]) for part in parts if part is not None]

    @property
    def modes(self) -> np.ndarray:
        """Numbers of the modes that are drawn (k,)."""
        if self.look is None:
            return np.zeros(0, int)
        return np.flatnonzero((self.look.probability >= MIN_PROBABILITY) & np.isfinite(self.look.mode[:, 0]))


def find_places(run: Path, fields: Mapping[str, ErrorField], recording: Recording) -> list[Place]:
    """Each method's worst places, apart from one another, with the worst heading of each."""
    places: list[Place] = []
    for method, field in fields.items():
        row, order = np.asarray(find_worst(field).row), np.argsort(-field.worst, kind="stable")
        chosen = thin(field.truth[None, order], OTHERS if places else PLACES, MIN_SEPARATION_M)
        worst = row[order[np.unique(chosen)]].tolist()
        some = [
            Place(method, field, (i, j), recording.test_observation[i, j], f"Worst place {rank} of {len(worst)}")
            for rank, (i, j) in enumerate(worst, 1)
        ]
        places += look_at(run, method, some, recording)
    return places


def look_at(run: Path, method: str, places: Sequence[Place], recording: Recording) -> list[Place]:
    """The places with what registration says of their images; without, if the method says nothing of it."""
    folder = folder_of(run, method)
    if not places or places[0].field.reason is None or not is_finished(folder):
        return list(places)
    positioner = adapt(load_positioner(folder), open_deployment(recording))[0]
    if not isinstance(positioner, FeaturePositioner) or positioner.appearance is None:
        return list(places)
    images, known = np.stack([place.image for place in places]), positioner.appearance.registration
    found = positioner.register(images)
    assert found is not None
    weight, near = [None] * len(images), [None] * len(images)
    if known.pixels is not None:
        match = known.pixels.register(grey(positioner.set_upright(images)), found.mode[:, 0], known.tree, known.kernel)
        turned = zip(match.weight, match.yaw - known.pixels.heading, strict=True)
        weight = [turn_picture(one, -angle) for one, angle in turned]
    if isinstance(positioner, RegistrationPositioner):
        near = positioner.index[find_nearest(known.tree, found.mode[:, 0], NEIGHBOURS)[1]]
    mode = read_alignment(folder).apply(found.mode)
    looks = map(Look, mode, found.weight, found.unlike.tolist(), weight, near)
    return [replace(place, look=look) for place, look in zip(places, looks, strict=True)]


def log_places(stream: rr.RecordingStream, places: Sequence[Place], recording: Recording, truth: Truth) -> None:
    """Log of each place its arrow, modes and numbers, its image, and the training images at the answer and closest.

    The worst is also at the start of the drive.
    """
    fields = {place.method: place.field for place in places}
    numbers = rr.TimeColumn(PLACE, sequence=range(1, len(places) + 1))
    _log(stream, places, recording, truth, fields, [numbers])
    _log(stream, places[:1], recording, truth, fields, start_row(find_span(recording)))


def _log(
    stream: rr.RecordingStream,
    places: Sequence[Place],
    recording: Recording,
    truth: Truth,
    fields: Mapping[str, ErrorField],
    at: Rows,
) -> None:
    """Log places with the errors of all methods."""
    tree, pose = KDTree(truth.pose[:, :2]), np.array([place.pose for place in places])
    predicted = np.array([place.field.predicted[place.at] for place in places])
    closest, around = tree.query(pose[:, :2])[1], find_nearest(tree, predicted, NEIGHBOURS)[1]
    compared = [None if place.look is None else place.look.near for place in places]
    near = np.array([other if one is None else one for one, other in zip(compared, around, strict=True)])
    shown = np.column_stack([near[:, :ANSWER_IMAGES], closest])  # Numbers of training images
    taken = truth.pose[shown]
    for lengths, shapes in _draw(places, pose, predicted, taken, truth.pose[near, :2]):
        send_shapes(stream, "world/place", at, shapes, lengths)
    texts = {"text": [_describe(*one, fields) for one in zip(places, taken, strict=True)]}
    send_rows(stream, "place/text", rr.TextDocument, at, texts, {"media_type": "text/markdown"})
    if recording.kind == "polar_image":
        found = np.array([place.yaw for place in places])
        turned = [
            np.stack(list(map(turn_picture, recording.observation[numbers], yaw - ahead)))
            for numbers, yaw, ahead in zip(shown.T, taken[..., 2].T, (found, found, pose[:, 2]), strict=True)
        ]
        marked = np.stack([mark_pixels(place.image, place.look and place.look.weight) for place in places])
        for name, images in zip(PICTURES, (np.stack([place.image for place in places]), marked, *turned), strict=True):
            log_round(stream, f"place/{name}", images, camera_of(recording), at)


def mark_pixels(image: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    """A polar image (rings, sectors, 3) in grey, coloured where weights (R, S) of its parts are low."""
    weight = np.ones((1, 1)) if weight is None else weight
    row, column = (np.arange(size) * weight.shape[axis] // size for axis, size in enumerate(image.shape[:2]))
    marked = (1.0 - weight[row][:, column, None]) ** 2
    return ((1.0 - marked) * 0.7 * image.mean(axis=2, keepdims=True) + marked * MARK).astype(np.uint8)


def _describe(place: Place, taken: np.ndarray, fields: Mapping[str, ErrorField]) -> str:
    """Describe a place in Markdown: its numbers, what the other methods say there, and the training images."""
    x, y, heading = place.pose
    to_x, to_y = place.field.predicted[place.at]
    errors = [[title_of(name), *_write_errors(one, place.at[0])] for name, one in fields.items()]
    all_accepted = all(one.is_accepted[place.at[0]].all() for one in fields.values())
    away = np.linalg.norm(taken[:, :2] - place.pose[:2], axis=1)
    images = [
        [name.replace("_", " "), f"{x:.2f}, {y:.2f}", f"{one:.2f}", f"{round(np.degrees(yaw)) % 360}°"]
        for name, one, (x, y, yaw) in zip(TRAINING_IMAGES, away, taken, strict=True)
    ]
    return "\n\n".join(
        [
            f"# {title_of(place.method)}: {100 * place.field.error[place.at]:.1f} cm",
            f"{place.rank}. True position {x:.2f}, {y:.2f} m; predicted {to_x:.2f}, {to_y:.2f} m, at heading "
            f"{np.degrees(heading) % 360:.0f}°.",
            *_describe_trust(place),
            f"Errors here at each heading [cm]{'' if all_accepted else ' (in brackets: refused)'}:",
            tabulate(["method", *(f"{one:.0f}°" for one in np.degrees(place.headings))], errors),
            tabulate(IMAGE_COLUMNS, images),
            NOTE,
        ]
    )


def _describe_trust(place: Place) -> list[str]:
    """Say whether the method accepts the image, and its radii, or why it does not; nothing where it tells neither."""
    words, field = [], place.field
    if field.accepted is not None and field.accepted[place.at]:
        words.append("The method accepts this image.")
    elif field.accepted is not None:
        why = "" if field.reason is None else f": {WORDS[field.reason[place.at]]}"
        words.append(f"The method refuses this image{why}.")
    if place.radii:
        inner, outer = (100 * radius for radius in place.radii)
        words.append(f"It expects the true position within {inner:.1f} cm (68 %) or {outer:.1f} cm (95 %).")
    if place.look is not None:
        words.append(f"Its squared residual is {place.look.unlike:.2f} times the largest that is usual.")
    return [" ".join(words)] if words else []


def _write_errors(field: ErrorField, cell: int) -> list[str]:
    """Errors at each heading of a place [cm], in brackets where the method refuses the image."""
    rows = zip(100 * field.error[cell], field.is_accepted[cell], strict=True)
    return [f"{error:.1f}" if accepted else f"({error:.1f})" for error, accepted in rows]


def _draw(
    places: Sequence[Place], pose: np.ndarray, predicted: np.ndarray, taken: np.ndarray, near: np.ndarray
) -> list[tuple[list[int], Shapes]]:
    """What is drawn of the places, with how many shapes each of them has.

    Poses are true (n, 3); those of training images are (n, ANSWER_IMAGES + 1, 3), and the places of all with which an
    image is compared (n, k, 2) [m].
    """
    labels = [
        f"{100 * place.field.error[place.at]:.1f} cm{'' if place.field.is_accepted[place.at] else ', refused'}"
        for place in places
    ]
    true = pose[:, :2]
    above = true + [0, LABEL_ABOVE * np.ptp(places[0].field.truth[:, 1])]  # the viewer draws a label below its point
    answers, closest = taken[:, :-1].reshape(-1, 3), taken[:, -1]
    radii = [place.radii for place in places]
    sizes, counts = [len(some) for some in radii], [len(place.modes) for place in places]
    circles = draw_circles(np.repeat(predicted, sizes, axis=0), np.concatenate([[], *radii]), 5 * LAYER_M)
    looks = [(place.look, place.modes) for place in places if place.look is not None]
    modes = lift(np.concatenate([np.zeros((0, 2)), *(look.mode[some] for look, some in looks)]), 5 * LAYER_M)
    percent = [f"{100 * one:.1f} %" for look, some in looks for one in look.probability[some]]
    begin = lift(np.repeat(predicted, counts, axis=0), 5 * LAYER_M)
    ones: Shapes = {
        "error": ({"strips": draw_arrows(true, predicted, 5 * LAYER_M)}, COLOURS["test"], 0.014),
        "test": ({"positions": lift(true, 6 * LAYER_M)}, COLOURS["test"], 0.03),
        "label": ({"positions": lift(above, 6 * LAYER_M), "labels": labels}, LABEL_COLOUR, 0.0),
        # a training image may be both: the closest one's dot is the larger and the lower
        "closest": ({"positions": lift(closest[:, :2], 4 * LAYER_M)}, COLOURS["closest"], 0.05),
        "closest/heading": ({"strips": draw_headings(closest, 3)}, COLOURS["closest"], 0.014),
    }
    return [
        ([1] * len(places), ones),
        (
            [ANSWER_IMAGES] * len(places),
            {
                "answers": ({"positions": lift(answers[:, :2], 6 * LAYER_M)}, COLOURS["answer"], 0.03),
                "answers/heading": ({"strips": draw_headings(answers, 5)}, COLOURS["answer"], 0.014),
            },
        ),
        (
            [near.shape[1]] * len(places),
            {"near": ({"positions": lift(near.reshape(-1, 2), 3 * LAYER_M)}, COLOURS["answer"], 0.012)},
        ),
        (sizes, {"radius": ({"strips": circles}, COLOURS["test"], 0.007)}),
        (
            counts,
            {
                "modes/lines": ({"strips": np.stack([begin, modes], axis=1)}, OTHER_COLOUR, 0.008),
                "modes": ({"positions": modes, "labels": percent}, OTHER_COLOUR, 0.05),
            },
        ),
    ]


def draw_headings(pose: np.ndarray, layer: int) -> np.ndarray:
    """Arrows ahead of poses (n, 3) [m, m, rad] as ``draw_arrows`` draws them, in a layer."""
    ahead = HEADING_M * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    return draw_arrows(pose[:, :2], pose[:, :2] + ahead, layer * LAYER_M)


def turn_picture(polar: np.ndarray, angle: float) -> np.ndarray:
    """Turn a polar image (rings, sectors, ...) counter-clockwise by an angle [rad], to the nearest sector."""
    return np.roll(polar, round(angle / (2 * np.pi) * polar.shape[1]), axis=1)
