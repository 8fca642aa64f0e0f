"""Training observations that look like a test observation, whichever way the robot was heading."""

import cv2
import numpy as np

from sim.recording.format import Recording
from sim.recording.manifest import ObservationKind

MOST = 20_000  # observations compared; of longer recordings, evenly spread ones
ROWS, COLUMNS = 8, 64
CHUNK = 1_000


def find_alike(recording: Recording, tests: np.ndarray, count: int) -> np.ndarray:
    """Find the training observations most like each of some test observations.

    Polar images and scans are compared at every turn: the squared difference follows from a circular correlation.

    Args:
        recording: The recording; its training observations are read in pieces.
        tests: Test observations (T, ...).
        count: Number of training observations to find for each.

    Returns:
        Indices of training observations (T, count), the most alike first.
    """
    every = -(-len(recording.observation) // MOST)
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
        pictures = [cv2.resize(image, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA) for image in values]
        values = np.moveaxis(np.stack(pictures), 3, 1).reshape(len(values), -1, COLUMNS)
    elif kind != "scan":
        values = values.reshape(len(values), -1, 1)
    return np.nan_to_num(values.astype(np.float32))


def _compare(wanted: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Least squared difference (T, n), up to a constant, between T and n small arrays over all turns."""
    columns = known.shape[2]
    spectra, power = np.fft.rfft(known).conj(), (known**2).sum(axis=(1, 2))
    products = (np.einsum("rf,nrf->nf", np.fft.rfft(one), spectra) for one in wanted)
    return np.stack([power - 2 * np.fft.irfft(product, n=columns).max(axis=1) for product in products])
