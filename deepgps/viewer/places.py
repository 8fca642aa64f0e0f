"""Images that are looked at one by one: the worst of each method, and some that the first one refuses.

Each is shown beside the training images against which it was registered, with its modes and the pixels that differ.
The timelines ``place`` and ``progress`` walk through them and end with the worst of the first method, since the viewer
opens a timeline at its end.
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
from deepgps.evaluation.error_field import ErrorField, find_worst, read_all_headings
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.positioner.kriging import NEIGHBOURS, find_nearest
from deepgps.positioner.pixels import grey
from deepgps.positioner.positioner import FeaturePositioner, RegistrationPositioner
from deepgps.positioner.registration import REASONS, thin
from deepgps.positioner.stored_positioner import is_finished, load_positioner
from deepgps.reports.table import tabulate
from deepgps.viewer.drive import camera_of
from deepgps.viewer.error_field import draw_arrows
from deepgps.viewer.pictures import log_views
from deepgps.viewer.scene import LAYER_M, draw_circles, lift
from deepgps.viewer.stream import Shapes, find_span, place_rows, send_rows, send_shapes
from sim.recording.format import Recording, Truth

PLACES, OTHERS = 40, 12  # Worst places of the first method, and of each other
DIFFERENCES, DOUBTS = 12, 20  # Refused images that differ, and that look like several places, that are shown at most
MAX_COMPARED = 1_000  # Refused images among which these are chosen, those with the largest errors
MIN_SEPARATION_M = 0.25
MIN_PROBABILITY = 1e-3  # Of modes that are drawn
LABEL_ABOVE = 0.07  # as a share of the room's depth
ANSWER_IMAGES = 2
TRAINING_IMAGES = (*(f"answer_{number + 1}" for number in range(ANSWER_IMAGES)), "closest")
PICTURES = ("test", "weight", *TRAINING_IMAGES)
COLOURS = {"test": (255, 255, 255), "answer": (255, 196, 60), "closest": (63, 208, 165)}
OTHER_COLOUR, MARK = (255, 120, 60), np.array([255, 0, 200])
HEADING_M = 0.22
IMAGE_COLUMNS = ("image", "x, y [m]", "away [m]", "heading")
WORDS = ("accepted", "unlike all seen near by", "another place looks the same", "two answers contradict each other")
NOTE = (
    "Away: from the true position. Yellow: training images around the answer, against which registration compares, "
    "turned to the heading that it finds; green: the one taken nearest, turned to the true heading. Orange: places "
    "that explain the image, with probabilities. Magenta: pixels that are not as predicted at the likeliest place.\n\n"
    "Choose the timeline `place` at the bottom and press Ctrl and ← for the next place."
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
    field: ErrorField  # The errors among which it is
    cell: int  # Number of its position
    heading: int  # Number of its heading there
    image: np.ndarray  # The observation
    why: str  # Why it is shown
    look: Look | None = None  # What registration says of it; None: nothing

    @property
    def at(self) -> tuple[int, int]:
        """Its row and column in the error field."""
        return self.cell, self.heading

    @property
    def headings(self) -> np.ndarray:
        """Headings at its position (H,) [rad]."""
        return np.broadcast_to(self.field.heading, self.field.error.shape)[self.cell]

    @property
    def pose(self) -> np.ndarray:
        """Its true x, y [m], heading [rad] (3,)."""
        return np.append(self.field.truth[self.cell], self.headings[self.heading])

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
    def is_ambiguous(self) -> bool:
        """Whether it is refused since it may have been taken elsewhere, too."""
        return self.field.reason is not None and bool(self.field.reason[self.at] == REASONS.index("ambiguous"))

    @property
    def modes(self) -> np.ndarray:
        """Numbers of the modes that are drawn (k,); of an ambiguous image at least two."""
        if self.look is None:
            return np.zeros(0, int)
        count = np.arange(len(self.look.mode))
        shown = (self.look.probability >= MIN_PROBABILITY) | (self.is_ambiguous & (count < 2))
        return count[shown & np.isfinite(self.look.mode[:, 0])]


def find_places(run: Path, fields: Mapping[str, ErrorField], recording: Recording) -> list[Place]:
    """Each method's worst places, and refused images of the first that says why, apart from one another."""
    places, judge = [], next((name for name, field in fields.items() if field.reason is not None), None)
    for method, field in fields.items():
        row, order = np.asarray(find_worst(field).row), np.argsort(-field.worst, kind="stable")
        chosen = row[_spread(field.truth, order, OTHERS if places else PLACES)].tolist()
        some = [
            Place(method, field, i, j, recording.test_observation[i, j], f"Worst place {rank} of {len(chosen)}")
            for rank, (i, j) in enumerate(chosen, 1)
        ]
        if method == judge:
            shown = {place.at for place in some}
            refused = list_refused(run, method, field, recording)
            some += [place for place in refused if place.field is not field or place.at not in shown]
        some = look_at(run, method, some, recording)
        places += some[: len(chosen)] + choose_refused(some[len(chosen) :])
    return places


def list_refused(run: Path, method: str, field: ErrorField, recording: Recording) -> list[Place]:
    """Refused images of the test grid and of the deployment drive, at most ``MAX_COMPARED``."""
    drive, sources = open_deployment(recording), [(field, recording.test_observation, "on the test grid")]
    if drive is not None:
        use = read_all_headings(run, "use_field.npz")[method]
        sources.append((use, drive.observation[:, None], "in deployment"))
    refused = [
        Place(method, one, cell, heading, images[cell, heading], f"Refused {where}")
        for one, images, where in sources
        for cell, heading in np.asarray(find_worst(one, ~one.is_accepted).row).tolist()
    ]
    return sorted(refused, key=lambda place: -place.field.error[place.at])[:MAX_COMPARED]


def choose_refused(refused: Sequence[Place]) -> list[Place]:
    """Of images that were looked at, those most unlike all others, then those that look most like another place."""
    looks, truth = [one.look for one in refused if one.look is not None], np.array([one.pose[:2] for one in refused])
    if not looks:
        return []
    doubtful, chosen = np.array([one.is_ambiguous for one in refused]), []
    second, unlike = np.array([one.probability[1] for one in looks]), np.array([one.unlike for one in looks])
    for score, some, count in ((unlike, ~doubtful, DIFFERENCES), (second, doubtful, DOUBTS)):
        ranked = np.flatnonzero(some)[np.argsort(-score[some], kind="stable")]
        chosen += _spread(truth, ranked, count).tolist()
    return [refused[number] for number in chosen]


def _spread(truth: np.ndarray, order: np.ndarray, count: int) -> np.ndarray:
    """The first ``count`` of places (n, 2) [m] in an order (k,) that are apart."""
    return order[np.unique(thin(truth[None, order], count, MIN_SEPARATION_M))]


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
    """Log of each place its arrow, modes and numbers, its image, and the training images at the answer and closest."""
    fields: dict[str, ErrorField] = {}
    for place in places:
        fields.setdefault(place.method, place.field)  # on the test grid, as worst places come first
    tree, pose = KDTree(truth.pose[:, :2]), np.array([place.pose for place in places])
    predicted = np.array([place.field.predicted[place.at] for place in places])
    away, closest = tree.query(pose[:, :2])
    around = find_nearest(tree, predicted, NEIGHBOURS)[1]
    compared = [None if place.look is None else place.look.near for place in places]
    near = np.array([other if one is None else one for one, other in zip(compared, around, strict=True)])
    shown = np.column_stack([near[:, :ANSWER_IMAGES], closest])  # Numbers of training images
    at, taken = place_rows(len(places), find_span(recording)), truth.pose[shown]
    send_shapes(stream, "world/place", at, _draw(places, pose, predicted, taken))
    modes = [np.zeros((0, 2)), *(place.look.mode[place.modes] for place in places if place.look is not None)]
    counts, radii = [len(place.modes) for place in places], [place.radii for place in places]
    spots, begin = np.concatenate(modes), lift(np.repeat(predicted, counts, axis=0), 4 * LAYER_M)
    labels = [f"{100 * one:.1f} %" for place in places if place.look for one in place.look.probability[place.modes]]
    sizes = [len(some) for some in radii]
    circles = draw_circles(np.repeat(predicted, sizes, axis=0), np.concatenate([[], *radii]), 5 * LAYER_M)
    dots = lift(truth.pose[near.ravel(), :2], 3 * LAYER_M)
    for name, rows, colour, radius_m, lengths in (
        ("near", {"positions": dots}, COLOURS["answer"], 0.012, [near.shape[1]] * len(places)),
        ("radius", {"strips": circles}, COLOURS["test"], 0.007, sizes),
        ("modes/lines", {"strips": np.stack([begin, lift(spots, 4 * LAYER_M)], axis=1)}, OTHER_COLOUR, 0.008, counts),
        ("modes/places", {"positions": lift(spots, 5 * LAYER_M), "labels": labels}, OTHER_COLOUR, 0.05, counts),
    ):
        send_shapes(stream, "world/place", at, {name: (rows, colour, radius_m)}, lengths)
    texts = {
        "text": [_describe(number, places, fields, float(one)) for number, one in enumerate(away)],
        "taken": [_describe_images(*one) for one in zip(pose[:, :2], taken, strict=True)],
    }
    for name, rows in texts.items():
        send_rows(stream, f"place/{name}", rr.TextDocument, at, {"text": rows}, {"media_type": "text/markdown"})
    if recording.kind == "polar_image":
        found = np.array([place.yaw for place in places])
        turned = [
            np.stack(list(map(turn_picture, recording.observation[numbers], yaw - ahead)))
            for numbers, yaw, ahead in zip(shown.T, taken[..., 2].T, (found, found, pose[:, 2]), strict=True)
        ]
        marked = np.stack([mark_pixels(place.image, place.look and place.look.weight) for place in places])
        for name, images in zip(PICTURES, (np.stack([place.image for place in places]), marked, *turned), strict=True):
            log_views(stream, f"place/{name}", images, camera_of(recording), at)


def mark_pixels(image: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    """A polar image (rings, sectors, 3) in grey, coloured where weights (R, S) of its parts are low."""
    weight = np.ones((1, 1)) if weight is None else weight
    row, column = (np.arange(size) * weight.shape[axis] // size for axis, size in enumerate(image.shape[:2]))
    marked = (1.0 - weight[row][:, column, None]) ** 2
    return ((1.0 - marked) * 0.7 * image.mean(axis=2, keepdims=True) + marked * MARK).astype(np.uint8)


def _describe(number: int, places: Sequence[Place], fields: Mapping[str, ErrorField], away_m: float) -> str:
    """Describe a place in Markdown: its numbers, and what the other methods say there."""
    place = places[number]
    x, y, heading = place.pose
    to_x, to_y = place.field.predicted[place.at]
    blocks = [
        f"# {title_of(place.method)}: {100 * place.field.error[place.at]:.1f} cm",
        f"{place.why}; {len(places) - number} on the timeline `place`.",
        f"True position {x:.2f}, {y:.2f} m; predicted {to_x:.2f}, {to_y:.2f} m, at heading "
        f"{np.degrees(heading) % 360:.0f}°. The closest training image was taken {away_m:.2f} m away.",
        *_describe_trust(place),
    ]
    if place.field is fields[place.method]:
        errors = [[title_of(name), *_write_errors(one, place.cell)] for name, one in fields.items()]
        all_accepted = all(one.is_accepted[place.cell].all() for one in fields.values())
        blocks.append(f"Errors here at each heading [cm]{'' if all_accepted else ' (in brackets: refused)'}:")
        blocks.append(tabulate(["method", *(f"{one:.0f}°" for one in np.degrees(place.headings))], errors))
    return "\n\n".join(blocks)


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


def _describe_images(true: np.ndarray, taken: np.ndarray) -> str:
    """Say in Markdown where the training images (ANSWER_IMAGES + 1, 3) were taken, and how to walk through them."""
    away = np.linalg.norm(taken[:, :2] - true, axis=1)
    images = [
        [name.replace("_", " "), f"{x:.2f}, {y:.2f}", f"{one:.2f}", f"{round(np.degrees(yaw)) % 360}°"]
        for name, one, (x, y, yaw) in zip(TRAINING_IMAGES, away, taken, strict=True)
    ]
    return "\n\n".join(["Where the training images were taken:", tabulate(IMAGE_COLUMNS, images), NOTE])


def _draw(places: Sequence[Place], pose: np.ndarray, predicted: np.ndarray, taken: np.ndarray) -> Shapes:
    """Each place's arrow, label and heading, and dots and headings of the training images (n, ANSWER_IMAGES + 1, 3)."""
    labels = [
        f"{100 * place.field.error[place.at]:.1f} cm{'' if place.field.is_accepted[place.at] else ', refused'}"
        for place in places
    ]
    true = pose[:, :2]
    above = true + [0, LABEL_ABOVE * np.ptp(places[0].field.truth[:, 1])]  # the viewer draws a label below its point
    shapes: Shapes = {
        "error": ({"strips": draw_arrows(true, predicted, 5 * LAYER_M)}, COLOURS["test"], 0.014),
        "test": ({"positions": lift(true, 6 * LAYER_M)}, COLOURS["test"], 0.03),
        "test/label": ({"positions": lift(above, 6 * LAYER_M), "labels": labels}, COLOURS["test"], 0.0),
    }
    for name, one in zip(TRAINING_IMAGES, np.swapaxes(taken, 0, 1), strict=True):
        # a training image may be both: the closest one's dot is the larger and the lower
        kind, closest = name.partition("_")[0], name == TRAINING_IMAGES[-1]
        dots, arrows = lift(one[:, :2], (4 if closest else 6) * LAYER_M), draw_headings(one, (3 if closest else 5))
        shapes[name] = ({"positions": dots}, COLOURS[kind], 0.05 if closest else 0.03)
        shapes[f"{name}/heading"] = ({"strips": arrows}, COLOURS[kind], 0.014)
    return shapes


def draw_headings(pose: np.ndarray, layer: int) -> np.ndarray:
    """Arrows ahead of poses (n, 3) [m, m, rad] as ``draw_arrows`` draws them, in a layer."""
    ahead = HEADING_M * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    return draw_arrows(pose[:, :2], pose[:, :2] + ahead, layer * LAYER_M)


def turn_picture(polar: np.ndarray, angle: float) -> np.ndarray:
    """Turn a polar image (rings, sectors, ...) counter-clockwise by an angle [rad], to the nearest sector."""
    return np.roll(polar, round(angle / (2 * np.pi) * polar.shape[1]), axis=1)
