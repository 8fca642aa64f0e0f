"""Comparison of images with the training images that match them best, rotated to their heading.

The correlation is a visual compass's (``deepgps/positioner/headings.py``), which a gain of the light does not change.
Two images of one place correlate well; how well images of different places do, the training images tell.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.spatial import KDTree

from deepgps.positioner.heading_fit import thin_out
from deepgps.positioner.headings import (
    correlate,
    find_largest,
    find_nearest,
    learn_looks,
    pool_rings,
    take_looks,
    take_phases,
)
from sim.recording.format import Recording
from sim.sensors.camera.mount import Upright

CELL_M = 0.05
"""Of the training images, one is known in each square of the map with sides of this length [m]."""
NEAREST, ALIKE = 4, 4
"""Known images that an image is compared with: those nearest to its predicted position, and those most alike."""
CYCLES, AZIMUTHS = 16, 32
"""Cycles around the circle that are kept of the images' values, and values around it that are compared."""
STEPS = 12
"""Steps of brightness, each with as many values, in which the light is compared."""
CHECKED = 400
"""Training images from which limits come, at most."""
APART_M = 1.0
"""Images farther apart on the map than this, or than half of the map, are of different places [m]."""
AROUND = 32
"""Images among which one of another segment is looked for."""
CHUNK = 64


@dataclass(frozen=True)
class Comparison:
    """How B images compare with the known ones.

    Attributes:
        correlation: Correlation with the best match (B,).
        relit: How far values are from those of the match (B,), in steps of 8 bits: the median over ``STEPS`` of the
            difference of medians. Furniture that covers less than half of the image does not change it.
        gain: Values over those of the match (B,), in the mean over these steps.
        away_m: Distance of the predicted position from the nearest known image's (B,) [m].
    """

    correlation: np.ndarray
    relit: np.ndarray
    gain: np.ndarray
    away_m: np.ndarray


@dataclass(frozen=True)
class KnownImages:
    """Training images that cover the map evenly.

    Attributes:
        place: Predicted positions (E, 2) [m].
        phases: Their ring phases (E, L, K), as ``take_phases`` gives them.
        values: Fourier coefficients of their values (E, rings, channels, ``CYCLES`` + 1).
        other_place: Correlation that one in a hundred images exceeds with images of other places.
        usual_match: Correlation that only one training image in a hundred is below.
        usual_light: ``relit`` that one training image in a hundred exceeds.
        gap_m: Distance from the nearest image of another segment that one training image in fifty exceeds [m].
    """

    place: np.ndarray
    phases: np.ndarray
    values: np.ndarray
    other_place: float = 0.0
    usual_match: float = 0.0
    usual_light: float = np.inf
    gap_m: float = np.inf

    def compare(
        self,
        images: np.ndarray,
        positions: np.ndarray,
        upright: Upright | None = None,
        apart_m: float = 0.0,
        own: np.ndarray | None = None,
    ) -> Comparison:
        """Compare images (B, rings, sectors, channels) predicted to be at positions (B, 2) [m].

        Args:
            images: The images.
            positions: Predicted positions of the camera.
            upright: What sets them upright; None: they are.
            apart_m: Known images nearer to the position than this are left out [m].
            own: The known image that each of them is itself (B,), which is left out; -1 or None: none.
        """
        chunks = [slice(start, start + CHUNK) for start in range(0, len(images), CHUNK)]
        own = np.full(len(images), -1) if own is None else own
        found = [
            self._compare(_set_upright(images[chunk], upright), positions[chunk], apart_m, own[chunk])
            for chunk in chunks
        ]
        correlation, relit, gain = np.concatenate([np.empty((3, 0)), *found], axis=1)
        return Comparison(correlation, relit, gain, np.asarray(self._tree.query(positions)[0]))

    def _compare(self, images: np.ndarray, positions: np.ndarray, apart_m: float, own: np.ndarray) -> np.ndarray:
        phases = take_phases(images)
        rows = self._choose(phases, positions, apart_m)
        angle, height = correlate(self.phases[rows], phases)
        best = np.where(rows == own[:, None], -np.inf, height[..., 0]).argmax(axis=1)[:, None]
        row, angle, height = (
            np.take_along_axis(one, best, axis=1)[:, 0] for one in (rows, angle[..., 0], height[..., 0])
        )
        return np.stack([height, *compare_light(take_values(images), turn(self.values[row], angle))])

    def _choose(self, phases: np.ndarray, positions: np.ndarray, apart_m: float) -> np.ndarray:
        """The known images (B, M) with which images with these phases (B, L, K) are compared."""
        known, mean = self._looks
        alike = take_looks(phases, mean) @ known.T
        if not apart_m:
            near = find_nearest(self._tree, positions, NEAREST)[1]
            return np.concatenate([near, find_largest(alike, ALIKE)], axis=1)
        away = np.linalg.norm(positions[:, None] - self.place, axis=2)
        return find_largest(np.where(away > apart_m, alike, -np.inf), ALIKE)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.place)

    @cached_property
    def _looks(self) -> tuple[np.ndarray, np.ndarray]:
        """What of each image no turn changes (E, L K), and its mean (L K,)."""
        return learn_looks(self.phases)


def learn_images(recording: Recording, upright: Upright | None, positions: np.ndarray) -> KnownImages:
    """Take the known images and their limits from a training recording.

    Args:
        recording: The recording that the method has learned from.
        upright: What sets its images upright; None: they are.
        positions: Positions of the camera that the method predicts for its images (N, 2) [m].
    """
    entry = thin_out(positions, CELL_M)
    rows = np.array_split(entry, -(-len(entry) // CHUNK))
    parts = (_set_upright(recording.observation[part], upright) for part in rows)
    phases, values = map(np.concatenate, zip(*((take_phases(part), take_values(part)) for part in parts), strict=True))
    known = KnownImages(positions[entry], phases, values)
    number = np.full(len(positions), -1)
    number[entry] = np.arange(len(entry))
    some = np.arange(0, len(positions), -(-len(positions) // CHECKED))
    images, place, own = recording.observation[some], positions[some], number[some]
    apart_m = min(APART_M, np.linalg.norm(positions - positions.mean(axis=0), axis=1).max() / 2.0)
    here, elsewhere = (known.compare(images, place, upright, away_m, own) for away_m in (0.0, apart_m))
    return replace(
        known,
        other_place=float(np.quantile(elsewhere.correlation, 0.99)),
        usual_match=float(np.quantile(here.correlation, 0.01)),
        usual_light=float(np.quantile(here.relit, 0.99)),
        gap_m=float(np.quantile(find_gaps(recording, positions), 0.98)),
    )


def find_gaps(recording: Recording, positions: np.ndarray) -> np.ndarray:
    """Distance of images from the nearest one of another segment (n,) [m], at most that of the ``AROUND`` nearest.

    Args:
        recording: The recording.
        positions: Positions of its observations (N, 2) [m].
    """
    number, first = np.unique(recording.reading[:, 1], return_index=True)  # at a turn, two segments share an image
    place, segment = positions[number], recording.reading[first, 0]
    away, rows = find_nearest(KDTree(place), place, AROUND)
    return np.where(segment[rows] != segment[:, None], away, away[:, -1:]).min(axis=1)


def take_values(images: np.ndarray) -> np.ndarray:
    """Fourier coefficients (B, rings, channels, ``CYCLES`` + 1) around the circle of images' values, rings pooled."""
    around = np.moveaxis(pool_rings(images), 3, 2)
    return np.asarray(fft.rfft(around))[..., : CYCLES + 1] / np.float32(images.shape[2])


def turn(values: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Coefficients (B, rings, channels, K) of images turned to the left by angles (B,) [rad]."""
    cycles = np.arange(values.shape[-1])
    return values * np.exp(1j * angle[:, None] * cycles)[:, None, None].astype(np.complex64)


def compare_light(seen: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``relit`` and ``gain`` of images by their coefficients and those of the images that match (B, ...)."""
    one, two = (np.asarray(fft.irfft(part, AZIMUTHS)) * AZIMUTHS for part in (seen, known))
    one, two = one.reshape(len(one), -1), two.reshape(len(two), -1)
    steps = np.array_split(np.argsort(two, axis=1), STEPS, axis=1)
    medians = [
        np.stack([np.median(np.take_along_axis(part, step, axis=1), axis=1) for step in steps]) for part in (one, two)
    ]
    gain = medians[0].mean(axis=0) / np.maximum(medians[1].mean(axis=0), 1.0)
    return np.median(np.abs(medians[0] - medians[1]), axis=0), gain


def _set_upright(images: np.ndarray, upright: Upright | None) -> np.ndarray:
    return images if upright is None else upright(images)
