"""What the camera alone says of the robot's headings: turns between segments, and pairs of images of one place.

Angles depend on the images alone, so recordings of one drive with other encoders share a ``Sight``.
"""

from dataclasses import dataclass, field

import numpy as np

from deepgps.data.turn_images import find_next, take_images, turns_with_images
from sim.errors import InputError
from sim.recording.format import Recording
from sim.recording.turns import NO_IMAGE, from_array
from sim.sensors.camera.lens import Lens, make_lens
from sim.sensors.compass.compass import Hypotheses, find_turns
from sim.settings import SimSettings

PAIRS = 300
"""Pairs of images of one place, taken on different segments, that are compared."""
NEAREST, FARTHEST = 25, 400
"""Observations that lie between the two images of a pair: enough for a curve to show, few enough to know the turns."""
LOOKS = 3000
"""Observations among which alike ones are sought."""
FREQUENCIES = 6
"""Lowest frequencies around the circle in the description of an image."""


@dataclass
class Sight:
    """The angles of one drive's images, each found once.

    Attributes:
        turns: Hypotheses of a turn by its two images: observation before, and turn image or -1 - observation after.
        pairs: Observations of pairs that look alike (P, 2), the earlier one first; None: not sought yet.
        pair_turns: Hypotheses of the angle from the first to the second of a pair.
    """

    turns: dict[tuple[int, int], tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=dict)
    pairs: np.ndarray | None = None
    pair_turns: Hypotheses | None = None


def see_turns(recording: Recording, sight: Sight) -> Hypotheses:
    """Hypotheses of all turns (T) of a recording.

    Raises:
        InputError: The recording has no turns or no polar images.
    """
    if (turns := turns_with_images(recording)) is None:
        raise InputError(
            f"{recording.folder} has no images after turns (turns.npy), with which the wheels are compared; record "
            "with drive.turn_images and an upward camera"
        )
    other = np.where(turns.image == NO_IMAGE, -1 - find_next(recording, turns), turns.image)
    keys = list(zip(turns.before.tolist(), other.tolist(), strict=True))
    if missing := [number for number, key in enumerate(keys) if key not in sight.turns]:
        found = find_turns(*take_images(recording, from_array(turns.array[missing])), _lens(recording))
        for number, *values in zip(missing, found.angle, found.std, found.weight, strict=True):
            sight.turns[keys[number]] = (values[0], values[1], values[2])
    return _join([sight.turns[key] for key in keys])


def see_pairs(recording: Recording, sight: Sight) -> tuple[np.ndarray, Hypotheses]:
    """Pairs of observations that look alike (P, 2), and hypotheses of the angle from the first to the second."""
    if sight.pairs is None or sight.pair_turns is None:
        sight.pairs = find_alike(recording.observation)
        one, two = sight.pairs.T
        sight.pair_turns = find_turns(recording.observation[one], recording.observation[two], _lens(recording))
    return sight.pairs, sight.pair_turns


def find_alike(images: np.ndarray) -> np.ndarray:
    """Pairs (P, 2) of images that look alike from any heading, a while apart; no more than ``PAIRS``, best first.

    An image is described by the amplitudes of the lowest frequencies around each ring, which no turn changes.

    Args:
        images: Polar images in the order driven (N, rings, sectors, channels).
    """
    looked = np.unique(np.linspace(0, len(images) - 1, min(len(images), LOOKS)).astype(int))
    described = np.stack([_describe(images[one]) for one in looked])
    square = (described**2).sum(axis=1)
    found: dict[tuple[int, int], float] = {}
    for row, one in enumerate(looked.tolist()):
        gap = looked - one  # only later ones: each pair is compared once
        fitting = np.flatnonzero((gap >= NEAREST) & (gap <= FARTHEST))
        if len(fitting):
            apart = square[fitting] - 2.0 * described[fitting] @ described[row]
            best = int(apart.argmin())
            found[one, int(looked[fitting[best]])] = float(apart[best] + square[row])
    best_first = sorted(found, key=found.__getitem__)[:PAIRS]
    return np.array(best_first, int).reshape(-1, 2)


def _describe(image: np.ndarray) -> np.ndarray:
    """Description of a polar image (rings x frequencies,), the same under every heading."""
    spectrum = np.abs(np.fft.rfft(image.mean(axis=2), axis=1))[:, : FREQUENCIES + 1]
    return np.sqrt(spectrum / image.shape[1]).ravel()


def _lens(recording: Recording) -> Lens:
    return make_lens(SimSettings.model_validate(recording.manifest.settings).camera)


def _join(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Hypotheses:
    """Hypotheses of several pairs, padded to the greatest number."""
    most = max((len(angle) for angle, _, _ in rows), default=1)
    angle, std, weight = (np.full((len(rows), most), fill) for fill in (np.nan, np.nan, 0.0))
    for place, values in enumerate(rows):
        for table, value in zip((angle, std, weight), values, strict=True):
            table[place, : len(value)] = value
    return Hypotheses(angle, std, weight, np.full((*angle.shape, 2), np.nan))
