"""Images that a method refuses: places where they may have been taken instead, and where in the view they differ.

The timelines ``refused`` and ``progress`` walk through them and end with the one most unlike all others. They are from
the test grid and from the deployment drive, where something may have changed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from deepgps.config.methods import folder_of, title_of
from deepgps.evaluation.deployment import adapt, open_deployment
from deepgps.evaluation.error_field import ErrorField, find_worst, read_all_headings
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.positioner.pixels import grey
from deepgps.positioner.positioner import FeaturePositioner
from deepgps.positioner.registration import REASONS, Registered, thin
from deepgps.positioner.stored_positioner import is_finished, load_positioner
from deepgps.viewer.drive import camera_of
from deepgps.viewer.pictures import log_views
from deepgps.viewer.places import COLOURS, MIN_SEPARATION_M, draw_headings, turn_picture
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.stream import REFUSED_IMAGE, Shapes, place_rows, send_rows, send_shapes
from sim.recording.format import Recording

DIFFERENCES, DOUBTS = 12, 20  # Images that differ, and images that look like several places, that are shown at most
MAX_COMPARED = 1_000  # Refused images that are registered again, those with the largest errors
OTHER_COLOUR, MARK = (255, 120, 60), np.array([255, 0, 200])
WORDS = ("Accepted", "Unlike all seen near by", "Another place looks the same", "Two answers contradict each other")
NOTE = (
    "White: where it was taken. Yellow: the place that explains it best; orange: others, with their probabilities. "
    "Magenta: pixels that are not as predicted from the training images around the best place.\n\n"
    "Choose the timeline `refused` at the bottom and press Ctrl and ← for the next of these images."
)


@dataclass(frozen=True)
class Refused:
    """Some refused images of one method, in the order in which they are shown."""

    method: str
    image: np.ndarray  # Observations (n, ...), images as if the camera had not leaned
    weight: np.ndarray | None  # Weight of each pixel, 1 where it agrees (n, R, S); None: pixels are not compared
    pose: np.ndarray  # True x, y [m], heading [rad] (n, 3)
    error: np.ndarray  # Distance of the method's answer from the truth (n,) [m]
    found: Registered  # Their registration, with modes in the world


def find_refused(run: Path, fields: Mapping[str, ErrorField], recording: Recording) -> Refused | None:
    """What the first of the methods refuses that says why; None if there is none, or if it refuses nothing."""
    method = next((name for name, field in fields.items() if field.reason is not None), "")
    if not method or not is_finished(folder := folder_of(run, method)):
        return None
    drive, sources = open_deployment(recording), [(fields[method], recording.test_observation)]
    if drive is not None:
        sources.append((read_all_headings(run, "use_field.npz")[method], drive.observation[:, None]))
    worst = [(find_worst(field, ~field.is_accepted), images) for field, images in sources]
    error = np.concatenate([one.error for one, _ in worst])
    if not len(error):
        return None
    chosen = np.argsort(-error, kind="stable")[:MAX_COMPARED]
    pose = np.concatenate([np.column_stack([one.truth, one.heading]) for one, _ in worst])[chosen]
    images = np.concatenate([images[tuple(np.asarray(one.row).T)] for one, images in worst])[chosen]
    positioner = adapt(load_positioner(folder), drive)[0]
    assert isinstance(positioner, FeaturePositioner) and positioner.appearance is not None
    found, images = positioner.register(images), positioner.set_upright(images)
    assert found is not None
    doubtful, order = found.reason == REASONS.index("ambiguous"), []
    second = found.weight[:, 1:].max(axis=1, initial=0.0)
    for score, some, count in ((found.unlike, ~doubtful, DIFFERENCES), (second, doubtful, DOUBTS)):
        ranked = np.flatnonzero(some)[np.argsort(-score[some], kind="stable")]
        order += ranked[np.unique(thin(pose[None, ranked, :2], count, MIN_SEPARATION_M))].tolist()
    found, weight = Registered(*(part[order] for part in vars(found).values())), None
    if (known := positioner.appearance.registration).pixels is not None:
        match = known.pixels.register(grey(images[order]), found.mode[:, 0], known.tree, known.kernel)
        turned = zip(match.weight, match.yaw - known.pixels.heading, strict=True)
        weight = np.stack([turn_picture(one, -angle) for one, angle in turned])
    found = replace(found, mode=read_alignment(folder).apply(found.mode))
    return Refused(method, images[order], weight, pose[order], error[chosen][order], found)


def log_refused(stream: rr.RecordingStream, refused: Refused, recording: Recording) -> None:
    """Log each image's modes with lines between, its pictures, and what is known of it."""
    at, best, others = place_rows(len(refused.pose), REFUSED_IMAGE), refused.found.mode[:, 0], refused.found.mode[:, 1:]
    known = np.isfinite(others).all(axis=2)
    here, there = np.broadcast_to(best[:, None], others.shape)[known], others[known]
    lines = {"strips": np.stack([lift(here, 4 * LAYER_M), lift(there, 4 * LAYER_M)], axis=1)}
    dots = _label(there, refused.found.weight[:, 1:][known])
    shapes: Shapes = {"lines": (lines, OTHER_COLOUR, 0.008), "others": (dots, OTHER_COLOUR, 0.05)}
    send_shapes(stream, "world/refused", at, shapes, known.sum(axis=1).tolist())
    arrows, places = {"strips": draw_headings(refused.pose, 6)}, {"positions": lift(refused.pose[:, :2], 6 * LAYER_M)}
    shapes = {"heading": (arrows, COLOURS["test"], 0.014), "truth": (places, COLOURS["test"], 0.03)}
    shapes["best"] = (_label(best, refused.found.weight[:, 0]), COLOURS["alike"], 0.05)
    send_shapes(stream, "world/refused", at, shapes)
    texts = {"text": [_describe(refused, number) for number in range(len(refused.pose))]}
    send_rows(stream, "refused/text", rr.TextDocument, at, texts, {"media_type": "text/markdown"})
    if refused.weight is not None:
        log_views(stream, "refused/image", refused.image, camera_of(recording), at)
        log_views(stream, "refused/weight", mark_pixels(refused.image, refused.weight), camera_of(recording), at)


def _label(mode: np.ndarray, probability: np.ndarray) -> dict[str, Any]:
    return {"positions": lift(mode, 5 * LAYER_M), "labels": [f"{100 * one:.0f} %" for one in probability]}


def mark_pixels(images: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Polar images (n, rings, sectors, 3) in grey, coloured where weights (n, R, S) of their parts are low."""
    row, column = (np.arange(size) * weight.shape[1 + axis] // size for axis, size in enumerate(images.shape[1:3]))
    marked = (1.0 - weight[:, row][:, :, column, None]) ** 2
    return ((1.0 - marked) * 0.7 * images.mean(axis=3, keepdims=True) + marked * MARK).astype(np.uint8)


def _describe(refused: Refused, number: int) -> str:
    (x, y, heading), found, place = refused.pose[number], refused.found, len(refused.pose) - number
    said = (
        f"{title_of(refused.method)} refuses it: *{REASONS[found.reason[number]]}*. Taken at {x:.2f}, {y:.2f} m, "
        f"heading {round(np.degrees(heading)) % 360}°; the answer is off by {100 * refused.error[number]:.1f} cm. Its "
        f"squared residual is {found.unlike[number]:.2f} times the largest that is usual. Image {place} of `refused`."
    )
    return f"# {WORDS[found.reason[number]]}\n\n{said}\n\n{NOTE}"
