"""Names why images are refused or suspicious, by comparing a deployment drive with what a method has learned from.

Images are named as they come, too, by each image and those before it. A camera that leans shows at turns only, and a
frozen image by wheels that move: neither is known here.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepgps.data.turns import MAX_TURNS, adapt_upright, compare_images, find_in_place, ignore_small, turns_with_images
from deepgps.positioner.positioner import FeaturePositioner, Positioner
from deepgps.positioner.registration import REASONS, Registered
from deepgps.tracking.image_checks import ImageLimits, check_images, find_driven, find_limits
from sim.recording.format import Recording
from sim.recording.turns import from_array
from sim.sensors.camera.mount import Upright

TITLES = {
    "black": "black image",
    "white": "white image",
    "covered": "lens covered",
    "frozen": "frozen image",
    "light": "light or exposure changed",
    "camera": "camera leans or moved",
    "other_room": "another room",
    "furniture": "furniture moved or someone in view",
    "new_place": "never or seldom been here",
}
"""Names of the causes in ``metrics.json``, and the causes in words."""
FAULTY_CAUSES = ("black", "white", "covered", "frozen")
"""Causes of images that do not show where the camera is or how it leans."""
WINDOW, NEW_ROOM_SHARE = 150, 0.95  # The robot is in another room if this share of so many consecutive images is new
NEIGHBOURS, SOME_SHARE, MAIN_SHARE = 50, 0.25, 0.5
"""Light or furniture have changed where the first share of so many images before and after an image show it. Where the
second share of them does, it is also why others are refused."""
LEAN_RINGS = 1.0 / 6.0
"""A camera has moved if it leans otherwise than in training by this part of a ring: 0.5 degrees with 32 rings."""
RELIT_RATIO = 2.0
"""An image is relit if its brightness differs this many times as much as that of one training image in a hundred."""
USUAL_LIMIT = 0.25  # One training image in a hundred exceeds it in ``unlike_features`` or ``unlike_pixels``
MIN_CAUSE_SHARE = 0.05  # A drive has a cause if this share of its images does

Signs = dict[str, np.ndarray]
"""What N images show, each by itself: arrays (N,) bool by name.

black, white, covered, frozen: by ``check_images``; accepted: the method accepts its position; known_place: it does, or
most of the pixels are those of one place on the map; relit: their brightness differs; changed: its features, which mix
all of the view, differ.
"""


def label(signs: Signs, around: Signs, leaning: bool, other_room: np.ndarray) -> np.ndarray:
    """Name of each image's cause, the first that holds (N,) str; empty: none.

    Light and furniture can change though an image is accepted. ``around`` are the shares of the images around each that
    are relit, and in which something has changed (N,); the camera is ``leaning`` otherwise than in training, and the
    method does not correct it; ``other_room`` (N,) bool: a long stretch of images nearly all of which are refused.
    """
    known, refused = signs["known_place"], ~signs["accepted"]
    relit, changed = (
        (signs[name] & (around[name] >= SOME_SHARE)) | (refused & (around[name] >= MAIN_SHARE))
        for name in ("relit", "changed")
    )
    rules = {
        **{name: signs[name] for name in FAULTY_CAUSES},
        "light": relit,
        "camera": refused & known & leaning,
        "other_room": refused & other_room,
        "furniture": changed,
        "": ~refused,
        "new_place": refused,
    }
    return np.select(list(rules.values()), list(rules), "")


def describe_causes(causes: Mapping[str, Any]) -> str:
    """Describe in a sentence what ``Causes.summarise`` returns."""
    named, refused = causes["named"], causes["refused"]
    parts = [f"{100 * causes['accepted']:.1f} % of images accepted"]
    if refused:
        parts.append(f"refused: {_list_shares(refused)}")
    if suspicious := {name: causes["shares"][name] for name in named if name in causes["shares"]}:
        suspicious = {name: share for name, share in suspicious.items() if share > refused.get(name, 0.0)}
        parts += [f"with those accepted: {_list_shares(suspicious)}"] if suspicious else []
    if "light" in named:
        parts.append(f"pixel values are {causes['gain']:.2f} times those in training")
    if "camera" in named:
        parts.append(f"the camera's lean differs by {causes['lean_deg']:.1f}° from that in training")
    return f"The deployment drive: {'; '.join(parts)}."


def _list_shares(shares: Mapping[str, float]) -> str:
    ordered = sorted(shares, key=lambda name: -shares[name])
    return ", ".join(f"{TITLES[name]} {100 * shares[name]:.1f} %" for name in ordered)


@dataclass(frozen=True)
class Causes:
    """What is wrong in a deployment drive of N images."""

    label: np.ndarray  # Name of each image's cause in ``TITLES`` (N,) str; empty: none
    accepted: np.ndarray  # Whether the method accepts it and it has no cause in ``FAULTY_CAUSES`` (N,) bool
    lean_deg: float | None  # Angle by which the camera leans otherwise than in training [deg]; None: no turns show it
    leans: bool  # Whether that is more than the images' size explains
    # Values of images over those in training, in the median of those of known places; None: there are none
    gain: float | None

    @property
    def named(self) -> list[str]:
        """Causes of the drive, that of most images first; a lean is one of all images."""
        shares = {name: share for name, share in _count(self.label).items() if share >= MIN_CAUSE_SHARE}
        seen = sum(share for name, share in shares.items() if name in FAULTY_CAUSES) < 0.5
        if seen and self.leans:
            shares["camera"] = 1.0
        return sorted(shares, key=lambda name: -shares[name])

    def summarise(self) -> dict[str, Any]:
        """Contents of ``in_use.causes`` in ``metrics.json``."""
        return {
            # Share of images accepted, without those that are black, white, covered or frozen
            "accepted": float(self.accepted.mean()),
            "named": self.named,  # Causes of the drive, that of most images first
            "shares": _count(self.label),  # Share of the images with each cause
            # Share of the images with each cause and refused
            "refused": _count(np.where(self.accepted, "", self.label)),
            # How far the camera leans from its lean in training [deg]; None: no turns show it
            "lean_deg": self.lean_deg,
            "gain": self.gain,  # Values of images over those in training
        }


def _count(labels: np.ndarray) -> dict[str, float]:
    """Share of the images with each cause; causes without images are left out."""
    shares = {name: float((labels == name).mean()) for name in TITLES}
    return {name: share for name, share in shares.items() if share}


@dataclass(frozen=True)
class Monitor:
    """What names the causes in drives of one method."""

    positioner: FeaturePositioner  # The method as trained
    upright: Upright | None  # What sets its training images upright; None: no turns show how the camera leans
    limits: ImageLimits  # Limits of single images

    def name(self, drive: Recording) -> Causes:
        """Name the causes in a drive."""
        upright, change = self._find_lean(drive)
        corrected, images = self.positioner.upright is not None, drive.observation
        leans = bool(upright and change and change > LEAN_RINGS * upright.lens.half_angle / images.shape[1])
        found = self.register(images, upright if corrected else None)
        signs = self.look(images, find_driven(drive), found)
        if leans and not corrected:  # what it shows is seen once it is upright
            signs = self.look(images, find_driven(drive), self.register(images, upright)) | {
                "accepted": signs["accepted"]
            }
        signs["changed"] &= not leans  # features of images that are set upright otherwise are others
        gain = found.gain[signs["known_place"]]
        causes = self.label(signs, leans and not corrected, min(WINDOW, len(images)))
        accepted = signs["accepted"] & ~np.isin(causes, FAULTY_CAUSES)
        lean_deg = None if change is None else float(np.degrees(change))
        return Causes(causes, accepted, lean_deg, leans, float(np.median(gain)) if len(gain) else None)

    def register(self, images: np.ndarray, upright: Upright | None = None) -> Registered:
        """Register polar images (N, rings, sectors, 3), set upright as in training or, if given, otherwise."""
        found = replace(self.positioner, upright=upright or self.positioner.upright).register(images)
        assert found is not None
        return found

    def _find_lean(self, drive: Recording) -> tuple[Upright | None, float | None]:
        """What sets a drive's images upright, and the angle between its lean and that in training [rad]."""
        if self.upright is None:
            return None, None
        upright, measured = adapt_upright(self.upright, drive)
        return upright, measured and float(np.linalg.norm(np.subtract(measured.lean, self.upright.lean)))

    def look(self, images: np.ndarray, moved: np.ndarray, found: Registered) -> Signs:
        """What each of polar images (N, ...) shows by itself; whether the wheels moved since the last one is (N,)."""
        assert self.positioner.appearance is not None
        accepted, least = found.reason == 0, RELIT_RATIO * self.positioner.appearance.registration.calibration.light
        known = accepted | ((found.reason != REASONS.index("ambiguous")) & (found.unlike_pixels <= USUAL_LIMIT))
        return {
            **check_images(images, moved, self.limits),
            "accepted": accepted,
            "known_place": known,
            "relit": known & (np.abs(np.log(np.maximum(found.gain, 1e-3))) > least),
            "changed": known & (found.unlike_features > USUAL_LIMIT),
        }

    def label(self, signs: Signs, leaning: bool, window: int) -> np.ndarray:
        """Like ``label``, where a stretch of another room has at least ``window`` images."""
        around = {name: share_around(signs[name]) for name in ("relit", "changed")}
        return label(signs, around, leaning, find_long(~signs["accepted"], window))


def make_monitor(positioner: Positioner, recording: Recording) -> Monitor | None:
    """What names causes for a method and the recording that it has learned from.

    None where the method compares no pixels.
    """
    if not isinstance(positioner, FeaturePositioner) or positioner.mirrored is None:
        return None
    upright = positioner.upright or measure_upright(recording)
    return Monitor(positioner, upright, find_limits(recording))


def measure_upright(recording: Recording) -> Upright | None:
    """What sets the images of a recording upright, by some of its turns in place; None: it has none with images."""
    turns = turns_with_images(recording)
    if turns is None or not len(rows := find_in_place(turns)):
        return None
    some = turns.array[rows[:: -(-len(rows) // MAX_TURNS)]]
    return ignore_small(compare_images(recording, from_array(some)).upright)


def name_causes(positioner: Positioner, recording: Recording, drive: Recording) -> Causes | None:
    """Name why a method trained on a recording refuses images of a deployment drive; None like ``make_monitor``."""
    monitor = make_monitor(positioner, recording)
    return None if monitor is None else monitor.name(drive)


class Watch:
    """Remembers what the last images have shown."""

    def __init__(self, monitor: Monitor) -> None:
        self._monitor = monitor
        self._signs = deque[Signs](maxlen=WINDOW)

    def step(self, image: np.ndarray) -> str:
        """Name of the cause of the next polar image (rings, sectors, 3); empty: none."""
        one, monitor = image[None], self._monitor
        self._signs.append(monitor.look(one, np.array([False]), monitor.register(one)))
        signs = {name: np.concatenate([each[name] for each in self._signs]) for name in self._signs[-1]}
        return str(monitor.label(signs, False, WINDOW)[-1])


def find_long(new: np.ndarray, size: int = WINDOW) -> np.ndarray:
    """Which images (N,) are in a stretch of ``size`` images nearly all of which are new (N,) bool."""
    long = np.zeros(len(new), bool)
    for start in range(len(new) - size + 1):
        if size and new[start : start + size].mean() >= NEW_ROOM_SHARE:
            long[start : start + size] = True
    return long


def share_around(found: np.ndarray) -> np.ndarray:
    """Share of the images within ``NEIGHBOURS`` of each image (N,) that have what is found (N,) bool."""
    total, rows = np.append(0, np.cumsum(found)), np.arange(len(found))
    first, last = np.maximum(rows - NEIGHBOURS, 0), np.minimum(rows + NEIGHBOURS + 1, len(found))
    return (total[last] - total[first]) / np.maximum(last - first, 1)
