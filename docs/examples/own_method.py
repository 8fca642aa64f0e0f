"""A method of one's own: the dead-reckoned position of the training image that looks most alike.

As a plugin: deepgps run tiny --plugin own_method.py --methods deepgps nearest_image
"""

import numpy as np
from scipy.spatial import KDTree

import deepgps
from deepgps.data.segments import dead_reckon


def describe(images: np.ndarray) -> np.ndarray:
    """Magnitudes (N, K) of each ring's Fourier coefficients, which do not change when the robot turns."""
    return np.abs(np.fft.rfft(images, axis=2)[:, :, :8]).reshape(len(images), -1).astype(np.float32)


def fit(recording, settings, seed, folder, progress) -> deepgps.Fitted:
    """Store a description and a dead-reckoned position of each training image."""
    seen, first = np.unique(recording.reading[:, 1], return_index=True)
    arrays = {"stored": describe(recording.observation[seen]), "place": dead_reckon(recording)[first, :2]}
    progress(folder.name, 1, 1)
    return deepgps.Fitted(arrays)


def predict(arrays, observations: np.ndarray) -> np.ndarray:
    """Positions (B, 2) [m] of observations, in the frame of dead reckoning."""
    return arrays["place"][KDTree(arrays["stored"]).query(describe(observations))[1]]


METHODS = {"nearest_image": deepgps.Method("Nearest image", "#c2255c", "SE2", fit, predict=predict, in_steps=False)}

if __name__ == "__main__":
    run = deepgps.simulate("tiny", methods=["nearest_image", "knn"], plugins=[__file__])
    for name in run.methods:
        print(f"{name}: {100 * run.metrics['methods'][name]['rms_m']:.1f} cm RMS")
