"""Drawing the worst places: marks on the floor plan, and each test image beside training images."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deepgps.viewer import playback
from deepgps.viewer.error_field import draw_arrows
from deepgps.viewer.run.drive import camera_of
from deepgps.viewer.run.radii import draw_circles
from deepgps.viewer.scene import LAYER_M, lift
from sim.recording.format import Recording

ALIKE = 2
PICTURES = ("test", *(f"alike_{number + 1}" for number in range(ALIKE)), "closest")
SHOWN: dict[str, tuple[int, int, int]] = {
    "test": (255, 255, 255),
    "alike": (255, 196, 60),
    "closest": (63, 208, 165),
}
ROUND_PX, POLAR_ZOOM = 256, 3
HEADING_M = 0.22
Times = list[rr.TimeColumn]  # of n places


def log_map(
    stream: rr.RecordingStream,
    true: np.ndarray,
    predicted: np.ndarray,
    refused: Sequence[bool],
    taken: np.ndarray,
    above_m: float,
    at: Times,
) -> None:
    """Log each place's arrow above all others, and where the training images were taken.

    Args:
        stream: Stream to log to.
        true: True positions (n, 2) [m].
        predicted: Predicted positions (n, 2) [m].
        refused: Whether the method refuses each image.
        taken: Poses of the training images (n, ALIKE + 1, 3) [m, m, rad].
        above_m: How far above its place the label is [m], since the viewer draws a label below its point.
        at: The times of the n places.
    """
    arrows = draw_arrows(true, predicted, 5 * LAYER_M)
    stream.log("world/place/error", rr.LineStrips3D.from_fields(radii=0.014, colors=[SHOWN["test"]]), static=True)
    stream.send_columns("world/place/error", at, rr.LineStrips3D.columns(strips=arrows))
    _log_dots(stream, "test", true, 0.03, 6 * LAYER_M, at)
    errors = zip(np.linalg.norm(predicted - true, axis=1), refused, strict=True)
    labels = [f"{100 * error:.1f} cm{', refused' if no else ''}" for error, no in errors]
    _log_labels(stream, "test", true + [0, above_m], labels, at)
    for number, name in enumerate(PICTURES[1:]):
        place, yaw = taken[:, number, :2], taken[:, number, 2]
        # a training image may be both: the closest one's dot is the larger and the lower
        closest = name == PICTURES[-1]
        _log_dots(stream, name, place, 0.05 if closest else 0.03, (4 if closest else 6) * LAYER_M, at)
        ahead = place + HEADING_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        arrows = draw_arrows(place, ahead, (3 if closest else 5) * LAYER_M)
        style = rr.LineStrips3D.from_fields(radii=0.014, colors=[_colour_of(name)])
        stream.log(f"world/place/{name}/heading", style, static=True)
        stream.send_columns(f"world/place/{name}/heading", at, rr.LineStrips3D.columns(strips=arrows))
        if not closest:
            _log_labels(stream, name, ahead, [name.removeprefix("alike_")] * len(true), at)


def log_radii(stream: rr.RecordingStream, predicted: np.ndarray, radii: Sequence[Sequence[float]], at: Times) -> None:
    """Log circles of some radii [m] around each predicted position (n, 2) [m]; a method without radii has none."""
    counts = [len(some) for some in radii]
    circles = draw_circles(
        np.repeat(predicted, counts, axis=0), np.array([one for some in radii for one in some]), 5 * LAYER_M
    )
    stream.log("world/place/radius", rr.LineStrips3D.from_fields(radii=0.007, colors=[SHOWN["test"]]), static=True)
    stream.send_columns("world/place/radius", at, rr.LineStrips3D.columns(strips=circles).partition(counts))


def _log_dots(
    stream: rr.RecordingStream, name: str, place: np.ndarray, radius_m: float, height_m: float, at: Times
) -> None:
    """Log a dot at one of the places (n, 2) [m] at each time."""
    style = rr.Points3D.from_fields(radii=radius_m, colors=[_colour_of(name)], point_shading="Flat")
    stream.log(f"world/place/{name}", style, static=True)
    stream.send_columns(f"world/place/{name}", at, rr.Points3D.columns(positions=lift(place, height_m)))


def _log_labels(stream: rr.RecordingStream, name: str, place: np.ndarray, labels: Sequence[str], at: Times) -> None:
    """Log a label below one of the places (n, 2) [m] at each time."""
    path = f"world/place/{name}/label"
    stream.log(path, rr.Points3D.from_fields(radii=0.0, colors=[_colour_of(name)], show_labels=True), static=True)
    stream.send_columns(path, at, rr.Points3D.columns(positions=lift(place, 6 * LAYER_M), labels=labels))


def _colour_of(name: str) -> tuple[int, int, int]:
    return SHOWN[name.partition("_")[0]]


def log_pictures(
    stream: rr.RecordingStream,
    recording: Recording,
    tests: np.ndarray,
    shown: np.ndarray,
    turn: np.ndarray,
    at: Times,
) -> None:
    """Log test images (n, ...) and training images, polar and as round pictures.

    Args:
        stream: Stream to log to.
        recording: The recording.
        tests: Test images (n, rings, sectors, 3).
        shown: Indices of training images (n, ALIKE + 1).
        turn: Angles by which training images are turned to the test image's heading (n, ALIKE + 1) [rad].
        at: The times of the n places.
    """
    _, rings, sectors, _ = recording.observation.shape
    warp = playback.make_warp(camera_of(recording), rings, sectors, ROUND_PX)
    images = {"test": list(tests)}
    for k, name in enumerate(PICTURES[1:]):
        rows = zip(recording.observation[shown[:, k]], turn[:, k], strict=True)
        images[name] = [turn_picture(image, angle) for image, angle in rows]
    for name, polar in images.items():
        large = [playback.enlarge(image, POLAR_ZOOM) for image in polar]
        rounds = [playback.warp_round(image, warp) for image in polar]
        for kind, pictures in (("polar", large), ("round", rounds)):
            path, blobs = f"place/{name}/{kind}", [playback.encode_jpeg(picture) for picture in pictures]
            stream.log(path, rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)
            stream.send_columns(path, at, rr.EncodedImage.columns(blob=blobs))


def turn_picture(polar: np.ndarray, angle: float) -> np.ndarray:
    """Turn a polar image (rings, sectors, ...) counter-clockwise by an angle [rad], to the nearest sector."""
    return np.roll(polar, round(angle / (2 * np.pi) * polar.shape[1]), axis=1)
