"""Spectral features of polar images: they do not change when the robot turns.

Turning shifts a polar image along its sectors, which multiplies every ring's Fourier coefficient of frequency f by the same
phase ``exp(i f turn)``. Magnitudes lose it ("Fourier signature"), and so does the product of one ring's coefficient with the
conjugate of the next ring's, which keeps how the rings lie to one another. Square roots even out the range.
"""

from dataclasses import dataclass

import numpy as np
import torch

from deepgps.settings import FeatureSettings
from sim.errors import InputError

CHUNK = 500


@dataclass(frozen=True)
class Features:
    """Projection of spectra to standardised principal components, fitted on training observations.

    Attributes:
        shape: Shape of one observation.
        frequencies: Highest frequency kept around the circle; unused for vectors.
        mean: Mean of the descriptions (K,).
        basis: Principal axes, each divided by its standard deviation (K, components).
    """

    shape: tuple[int, ...]
    frequencies: int
    mean: torch.Tensor
    basis: torch.Tensor

    def apply(self, observation: np.ndarray) -> torch.Tensor:
        """Features of observations (N, rings, sectors, 3) uint8 or (N, M) float: (N, components) float32."""
        if tuple(observation.shape[1:]) != self.shape:
            raise InputError(f"observations of shape {observation.shape[1:]}, but trained on {self.shape}")
        chunks = [
            (describe(observation[start : start + CHUNK], self.frequencies) - self.mean) @ self.basis
            for start in range(0, len(observation), CHUNK)
        ]
        return torch.cat(chunks) if chunks else torch.zeros((0, self.basis.shape[1]))


def describe(observation: np.ndarray, frequencies: int) -> torch.Tensor:
    """Heading-invariant description of each observation; vectors are taken as they are.

    Args:
        observation: Polar images (N, rings, sectors, 3) uint8, or vectors (N, M).
        frequencies: Highest frequency kept.

    Returns:
        float32 (N, K).

    Raises:
        InputError: for any other shape.
    """
    array = np.asarray(observation)
    if array.ndim == 2:
        return torch.from_numpy(array.astype(np.float32))
    if array.ndim != 4:
        raise InputError(f"observations must be (N, rings, sectors, colours) or (N, M), not {array.shape}")
    image = torch.from_numpy(array.transpose(0, 1, 3, 2).astype(np.float32) / 255.0)
    spectrum = torch.fft.rfft(image, norm="forward")[..., : frequencies + 1]
    magnitude = spectrum.abs().sqrt()
    product = spectrum[:, :-1, :, 1:] * spectrum[:, 1:, :, 1:].conj()
    # Amplitude |product|^(1/4) is of the size of a magnitude's square root; the phase is kept. The small
    # number keeps the phase of an empty pair from being noise.
    product = product / (product.abs() + 1e-8) ** 0.75
    return torch.cat([magnitude.flatten(1), torch.view_as_real(product).flatten(1)], dim=1)


def fit_features(
    observation: np.ndarray, settings: FeatureSettings, generator: torch.Generator
) -> tuple[Features, torch.Tensor]:
    """Fit the projection on training observations and apply it to them.

    The principal axes come from randomised subspace iteration (Halko, Martinsson, Tropp 2011, algorithm 4.4).

    Returns:
        The projection and the observations' features (N, components), each of mean 0 and variance 1.
    """
    described = torch.cat(
        [
            describe(observation[start : start + CHUNK], settings.frequencies)
            for start in range(0, len(observation), CHUNK)
        ]
    )
    mean = described.mean(dim=0)
    described -= mean
    axes = _principal_axes(described, min(settings.components, *described.shape), generator)
    projected = described @ axes
    spread = projected.std(dim=0).clamp_min(1e-6)
    shape = tuple(observation.shape[1:])
    return Features(shape, settings.frequencies, mean, axes / spread), projected / spread


def _principal_axes(centred: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    width = min(count + 16, *centred.shape)
    guess = torch.randn((centred.shape[1], width), generator=generator)
    for _ in range(3):
        guess, _ = torch.linalg.qr(centred.T @ (centred @ guess))
    _, _, axes = torch.linalg.svd(centred @ guess, full_matrices=False)
    return (guess @ axes.T)[:, :count]
