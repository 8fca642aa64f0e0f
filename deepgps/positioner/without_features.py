"""Positioners that compare no features: the nearest stored scan, which is what the paper's PCA + KNN learns (its
appendix), and a plugin's arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from deepgps.config.methods import find_method
from deepgps.data.features import check_shape
from deepgps.positioner.positioner import Packed, Positioner
from sim.errors import WorkError
from sim.plugins import name_code

NAMES = ("mean", "axes", "known", "places")


@dataclass(frozen=True)
class ScanPositioner(Positioner):
    """Positions by the nearest stored scan, in principal components."""

    kind = "scans"

    mean: np.ndarray  # Mean scan (rays,) [m]
    axes: np.ndarray  # Principal axes (components, rays)
    known: np.ndarray  # Stored scans (N headings, components) float32, with those of one position adjacent
    places: np.ndarray  # Their positions (N, 2) float64 [m]
    turns: int  # Number of scans stored for each position

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        from sklearn.metrics import pairwise_distances_argmin

        check_shape(observations[:, 0], self.mean.shape)
        if not len(observations):
            return np.zeros((0, 2))
        with threadpool_limits(1):  # which of two equal neighbours is found depends on how the work is divided
            nearest = pairwise_distances_argmin(self.project(np.asarray(observations[:, 0])), self.known)
        return self.places[nearest // self.turns]

    def project(self, scans: np.ndarray) -> np.ndarray:
        """Principal components (n, components) float32 of scans (n, rays) [m]."""
        return (scans - self.mean) @ self.axes.T

    def pack(self) -> Packed:
        return Packed({name: torch.from_numpy(getattr(self, name)) for name in NAMES}, {"headings": self.turns})

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        mean, axes, known, places = (packed.tensors[name].numpy() for name in NAMES)
        return cls(mean, axes, known, places, packed.numbers["headings"])


@dataclass(frozen=True)
class ArrayPositioner(Positioner):
    """Positions by a plugin's method from the arrays that it has learned."""

    kind = "arrays"

    method: str  # Name of the method, whose plugin must be loaded
    arrays: Mapping[str, np.ndarray]  # What it has learned, by name

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        method = find_method(self.method)
        assert method.predict is not None
        found, shape = np.asarray(method.predict(self.arrays, np.asarray(observations)), float), (len(observations), 2)
        if found.shape != shape:
            raise WorkError(f"{name_code(method.predict)} must return positions {shape}, not {found.shape}")
        return found

    def pack(self) -> Packed:
        arrays = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in self.arrays.items()}
        return Packed(arrays, {"method": self.method})

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        return cls(packed.numbers["method"], {name: tensor.numpy() for name, tensor in packed.tensors.items()})
