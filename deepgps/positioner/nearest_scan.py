"""Positions by the stored scan most similar to the observed one: what the paper's PCA + KNN learns (its appendix)."""

from dataclasses import dataclass

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from sim.errors import InputError

NAMES = ("mean", "axes", "known", "places")


@dataclass(frozen=True)
class ScanPositioner:
    """Positions by the nearest stored scan, in principal components.

    Attributes:
        mean: Mean scan (rays,) [m].
        axes: Principal axes (components, rays).
        known: Stored scans (N headings, components) float32, with those of one position adjacent.
        places: Their positions (N, 2) float64 [m].
        headings: Number of scans stored for each position.
    """

    mean: np.ndarray
    axes: np.ndarray
    known: np.ndarray
    places: np.ndarray
    headings: int

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Positions (B, 2) float64 [m] of scans (B, headings, rays), using only the first heading."""
        from sklearn.metrics import pairwise_distances_argmin

        if observations.ndim != 3 or observations.shape[2] != len(self.mean):
            raise InputError(
                f"observations of shape {observations.shape[1:]}, but trained on scans of {len(self.mean)} rays"
            )
        if not len(observations):
            return np.zeros((0, 2))
        with threadpool_limits(1):  # which of two equal neighbours is found depends on how the work is divided
            nearest = pairwise_distances_argmin(self.project(np.asarray(observations[:, 0])), self.known)
        return self.places[nearest // self.headings]

    def project(self, scans: np.ndarray) -> np.ndarray:
        """Principal components (n, components) float32 of scans (n, rays) [m]."""
        return (scans - self.mean) @ self.axes.T

    def tensors(self) -> dict[str, torch.Tensor]:
        """The stored arrays as tensors, by name."""
        return {name: torch.from_numpy(getattr(self, name)) for name in NAMES}
