"""The worst places of each method: a test image, the training images like it, and where those were taken.

The timeline ``place`` walks through them, the worst of the first method first; on ``progress`` they come in the
opposite order, so that the viewer opens with the worst.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from scipy.spatial import KDTree

from deepgps.evaluation.error_field import ErrorField, find_worst
from deepgps.figures.markdown import tabulate
from deepgps.methods.catalog import title_of
from deepgps.viewer import playback
from deepgps.viewer.error_field import draw_arrows
from deepgps.viewer.run.alike import find_alike
from deepgps.viewer.run.drive import camera_of
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import place_index
from sim.recording.format import Recording, Truth

PLACES = 12  # of each method
APART_M = 0.25
ALIKE = 2
PICTURES = ("test", *(f"alike_{number + 1}" for number in range(ALIKE)), "closest")
ROUND_PX, POLAR_ZOOM = 256, 3
SHOWN: dict[str, tuple[int, int, int]] = {
    "test": (255, 255, 255),
    "alike": (255, 196, 60),
    "closest": (63, 208, 165),
}


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
    away, closest = KDTree(truth.pose[:, :2]).query([fields[place.method].truth[place.cell] for place in places])
    shown = np.column_stack([alike, closest])  # indices of training observations
    at = place_index(len(places))
    _log_map(stream, fields, places, truth.pose[shown], at)
    texts = [
        _describe(number, places, fields, truth.pose[shown[number]], float(away[number]))
        for number in range(len(places))
    ]
    stream.log("place/text", rr.TextDocument.from_fields(media_type="text/markdown"), static=True)
    stream.send_columns("place/text", at, rr.TextDocument.columns(text=texts))
    if recording.kind == "polar_image":
        _log_pictures(stream, recording, tests, shown, at)


def _log_map(
    stream: rr.RecordingStream,
    fields: Mapping[str, ErrorField],
    places: Sequence[Place],
    taken: np.ndarray,
    at: list[rr.TimeColumn],
) -> None:
    """Log the place's arrow above all others, and the poses (n, ALIKE + 1, 3) at which training images were taken."""
    worst = {method: find_worst(field) for method, field in fields.items()}
    cells = [(worst[place.method], place.cell) for place in places]
    true, predicted = (
        np.stack([getattr(field, part)[cell] for field, cell in cells]) for part in ("truth", "predicted")
    )
    arrows = draw_arrows(true, predicted, 5 * LAYER_M)
    stream.log("world/place/error", rr.LineStrips3D.from_fields(radii=0.014, colors=[SHOWN["test"]]), static=True)
    stream.send_columns("world/place/error", at, rr.LineStrips3D.columns(strips=arrows))
    labels = [f"{100 * field.error[cell]:.1f} cm" for field, cell in cells]
    _log_marks(stream, "test", true, None, labels, at)
    for number, name in enumerate(PICTURES[1:]):
        label = [name.replace("alike_", "")] * len(places)
        _log_marks(stream, name, taken[:, number, :2], taken[:, number, 2], label, at)


def _log_marks(
    stream: rr.RecordingStream,
    name: str,
    place: np.ndarray,
    yaw: np.ndarray | None,
    labels: Sequence[str],
    at: list[rr.TimeColumn],
) -> None:
    """Log a labelled dot at one of the places (n, 2) [m] at each time, and an arrow along its heading (n,) [rad]."""
    path, colour = f"world/place/{name}", SHOWN[name.partition("_")[0]]
    stream.log(path, rr.Points3D.from_fields(radii=0.03, colors=[colour], show_labels=True), static=True)
    stream.send_columns(path, at, rr.Points3D.columns(positions=lift(place, 6 * LAYER_M), labels=labels))
    if yaw is not None:
        ahead = place + 0.22 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        stream.log(f"{path}/heading", rr.LineStrips3D.from_fields(radii=0.014, colors=[colour]), static=True)
        arrows = draw_arrows(place, ahead, 5 * LAYER_M)
        stream.send_columns(f"{path}/heading", at, rr.LineStrips3D.columns(strips=arrows))


def _log_pictures(
    stream: rr.RecordingStream, recording: Recording, tests: np.ndarray, shown: np.ndarray, at: list[rr.TimeColumn]
) -> None:
    """Log test images (n, ...) and training images by their indices (n, ALIKE + 1), polar and as round pictures."""
    _, rings, sectors, _ = recording.observation.shape
    warp = playback.make_warp(camera_of(recording), rings, sectors, ROUND_PX)
    images = {"test": tests, **{name: recording.observation[shown[:, k]] for k, name in enumerate(PICTURES[1:])}}
    for name, polar in images.items():
        large = [playback.enlarge(image, POLAR_ZOOM) for image in polar]
        rounds = [playback.warp_round(image, warp) for image in polar]
        for kind, pictures in (("polar", large), ("round", rounds)):
            path, blobs = f"place/{name}/{kind}", [playback.encode_jpeg(picture) for picture in pictures]
            stream.log(path, rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)
            stream.send_columns(path, at, rr.EncodedImage.columns(blob=blobs))


def _describe(
    number: int, places: Sequence[Place], fields: Mapping[str, ErrorField], taken: np.ndarray, away_m: float
) -> str:
    """Describe a place in Markdown: its numbers, what the other methods say there, and the training images."""
    place = places[number]
    field = fields[place.method]
    true, predicted = field.truth[place.cell], field.predicted[place.cell, place.heading]
    heading = np.degrees(np.broadcast_to(field.heading, field.error.shape)[place.cell])
    errors = [
        [title_of(name), *(f"{100 * error:.1f}" for error in one.error[place.cell])] for name, one in fields.items()
    ]
    images = [
        [name, f"{pose[0]:.2f}, {pose[1]:.2f}", f"{np.linalg.norm(pose[:2] - true):.2f}", f"{np.degrees(pose[2]):.0f}°"]
        for name, pose in zip(("alike 1", "alike 2", "closest"), taken, strict=True)
    ]
    error_cm = 100 * field.error[place.cell, place.heading]
    return "\n\n".join(
        [
            f"# {title_of(place.method)}: {error_cm:.1f} cm",
            f"Worst place {place.rank} of this method, number {number + 1} of {len(places)} on the timeline `place`.",
            f"True position {true[0]:.2f}, {true[1]:.2f} m; predicted {predicted[0]:.2f}, {predicted[1]:.2f} m, "
            f"at heading {heading[place.heading]:.0f}°. The closest training image was taken {away_m:.2f} m away.",
            "Errors here at each heading [cm]:",
            tabulate(["method", *(f"{one:.0f}°" for one in heading)], errors),
            "Training images, and their distance from the true position:",
            tabulate(["image", "x, y [m]", "away [m]", "heading"], images),
        ]
    )
