"""Spectral features of polar images that do not change when the robot turns and change slowly as it drives.

Turning shifts a polar image along its sectors, which multiplies every ring's Fourier coefficient of frequency f by the
phase ``exp(i f turn)``. Magnitudes do not depend on it ("Fourier signature", Menegatti et al. 2004), nor does the
product of a ring's coefficient with the conjugate of the next ring's, which keeps how the rings are turned to one
another.

A lidar's scan is first drawn as a polar image: each ray fills the rings that it passes, so that a ring shows in which
directions there is free space at its distance.

Of these numbers the slowest linear combinations are kept (slow feature analysis, Wiskott and Sejnowski 2002): those
that vary much over the room and bend little between three consecutive readings of one segment. What is left out is
mostly aliasing and edges finer than the samples, with which a network would only overfit its training images.

Pixels may count by their ranks, which light rarely alters. Lamps that are off and windows at dusk brighten or darken
parts of a room, which ranks over the image do not undo: from copies under smooth random gains, slow features learn what
light changes.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from deepgps.config.learning import FeatureSettings, PixelValues
from deepgps.data.segments import Segments, subsample_learned
from sim.errors import InputError

CHUNK = 64  # fits a processor's cache
PRODUCT_FLOOR = 1e-8  # Added to the product of two magnitudes, so that the phase of an empty pair is not noise
MIN_VARIETY = 1e-6  # Smallest total difference of descriptions, relative to their size; less is the rounding of float32
RELIT_IMAGES, LIGHT_WEIGHT = 1500, 0.1
"""Images of which a copy under other light is described, at most; weight of what light changes beside what bends."""


@dataclass(frozen=True)
class Features:
    """Projection of descriptions, fitted on training observations."""

    shape: tuple[int, ...]  # Shape of one observation
    frequencies: int  # Highest frequency kept around the circle; unused for vectors
    mean: torch.Tensor  # Mean of the descriptions (K,)
    basis: torch.Tensor  # Projection (K, components)
    # Edges of the rings of a scan (rings + 1,) [m]; None if observations are not scans
    edges: torch.Tensor | None = None
    values: PixelValues = "pixels"  # What of an image's pixels is described; unused for scans and vectors

    def apply(self, observation: np.ndarray, heading: int = 0) -> torch.Tensor:
        """Features (N, components) float32 of observations as ``describe`` takes them, of scans at one heading."""
        check_shape(observation, self.shape)
        found = torch.empty((len(observation), self.basis.shape[1]))
        for start in range(0, len(observation), CHUNK):
            some = observation[start : start + CHUNK]
            described = describe(some, self.frequencies, self.edges, heading, self.values)
            torch.mm(described.sub_(self.mean), self.basis, out=found[start : start + CHUNK])
        return found


def check_shape(observation: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise InputError if observations do not have the shape trained on."""
    if tuple(observation.shape[1:]) != shape:
        raise InputError(f"observations of shape {tuple(observation.shape[1:])}, but trained on shape {shape}")


def describe(
    observation: np.ndarray,
    frequencies: int,
    edges: torch.Tensor | None = None,
    heading: int = 0,
    values: PixelValues = "pixels",
) -> torch.Tensor:
    """Heading-invariant description (N, K) float32 of each observation; vectors are returned unchanged.

    Observations are polar images (N, rings, sectors, colours) uint8, scans (N, headings, rays), of which one heading is
    used and drawn as rings with these edges (rings + 1,) [m], or vectors (N, M); InputError if they are anything else.
    With ranks as values, each pixel counts by its rank within its image, and not by its value.
    """
    array = np.asarray(observation)
    if array.ndim == 2:
        return torch.from_numpy(array.astype(np.float32))
    if array.ndim == 3 and edges is not None:
        image = draw_rings(torch.from_numpy(np.ascontiguousarray(array[:, heading])), edges)[:, :, None]
    elif array.ndim == 4:
        image = torch.from_numpy(np.ascontiguousarray(array.transpose(0, 1, 3, 2)))
        image = rank_values(image) if values == "ranks" else image.float()
    else:
        raise InputError(
            f"observations must be (N, rings, sectors, colours), (N, headings, rays) or (N, M), not {array.shape}"
        )
    sectors = image.shape[3]
    return describe_rings(image, make_waves(sectors, min(frequencies, sectors // 2)))


def describe_rings(
    image: torch.Tensor, wave: torch.Tensor, least: torch.Tensor | float = PRODUCT_FLOOR
) -> torch.Tensor:
    """Description (N, K) of images (N, rings, colours, sectors) float32 by ``make_waves``, as ONNX can express it."""
    count, rings, colours, sectors = image.shape
    real, imaginary = (image.reshape(-1, sectors) @ wave).view(count, rings, colours, 2, -1).unbind(dim=3)
    size = (real.square() + imaginary.square()).sqrt()
    a, b, c, d = real[:, :-1, :, 1:], imaginary[:, :-1, :, 1:], real[:, 1:, :, 1:], imaginary[:, 1:, :, 1:]
    # A product's amplitude to the power 1/4 is comparable to a magnitude's square root; its phase is kept.
    half = (size[:, :-1, :, 1:] * size[:, 1:, :, 1:] + least).sqrt()
    shrink = (half * half.sqrt()).reciprocal()
    product = torch.stack([(a * c + b * d) * shrink, (b * c - a * d) * shrink], dim=4)
    return torch.cat([size.sqrt().flatten(1), product.flatten(1)], dim=1)


@lru_cache(maxsize=8)
def make_waves(sectors: int, frequencies: int) -> torch.Tensor:
    """Cosines, then sines, of each frequency (sectors, 2 frequencies + 2).

    For a few frequencies a product with these is faster than a Fourier transform. The coefficients are means over the
    circle of an image between 0 and 1.
    """
    angle = 2.0 * np.pi / sectors * np.outer(np.arange(sectors), np.arange(frequencies + 1))
    wave = np.concatenate([np.cos(angle), -np.sin(angle)], axis=1) / (255.0 * sectors)
    return torch.from_numpy(wave.astype(np.float32))


def draw_rings(scan: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """Draw scans (N, rays) [m] as rings (N, rings, rays) between 0 and 255: the part of a ring that each ray passes.

    Between ``edges`` no information is lost: the rings' sum, each times its width, gives the distance.
    """
    low, width = edges[:-1, None], edges.diff()[:, None]
    return ((scan[:, None] - low) / width).clamp_(0.0, 1.0).mul_(255.0)


def find_edges(observation: np.ndarray, rings: int) -> torch.Tensor | None:
    """Edges (rings + 1,) [m] of rings that scans (N, headings, rays) [m] fill equally often; None if not scans."""
    if observation.ndim != 3:
        return None
    some = np.asarray(observation[:: max(1, len(observation) // 2000), 0], float)
    edges = np.quantile(some, np.linspace(0.0, 1.0, rings + 1))
    # at the end of the reach, many distances are the same
    edges = np.maximum.accumulate(edges + 1e-4 * np.arange(rings + 1))
    return torch.from_numpy(edges).float()


def fit_features(
    observation: np.ndarray, segments: Segments, settings: FeatureSettings, generator: torch.Generator
) -> tuple[Features, torch.Tensor]:
    """Fit the projection on observations that networks learn from and apply it to all; of many, a sample is fitted.

    Returns it and the observations' features (N, components); their mean square over the fitted sample is 1.
    """
    sample, chosen = subsample_learned(segments, len(observation))
    edges = find_edges(observation, settings.rings)
    described = _describe_all(observation, chosen.numpy(), settings, edges)
    mean = described.mean(dim=0)
    described -= mean
    _check_variety(described, mean)
    basis = _principal_axes(described, min(settings.principal, *described.shape), generator)
    changed = None
    if settings.values == "ranks" and observation.ndim == 4:
        changed = _describe_changes(observation, chosen.numpy(), settings.frequencies, generator) @ basis
    basis = basis @ _slow_axes(described @ basis, sample, settings.components, changed)
    projected = described @ basis
    size = projected.square().mean().sqrt().clamp_min(1e-12)
    shape = tuple(observation.shape[1:])
    fitted = Features(shape, settings.frequencies, mean, basis / size, edges, settings.values)
    return fitted, projected / size if len(chosen) == len(observation) else fitted.apply(observation)


def normalise(observation: np.ndarray) -> tuple[Features, torch.Tensor]:
    """Features of vectors (N, M), and their projection: each component is centred, all have a mean square of 1.

    Distances to landmarks change slowly along the drive, and not at all when the robot turns: no selection is needed.
    """
    described = describe(observation, 0)
    mean = described.mean(dim=0)
    described -= mean
    _check_variety(described, mean)
    size = described.square().mean().sqrt().clamp_min(1e-12)
    basis = torch.eye(described.shape[1]) / size
    return Features(tuple(observation.shape[1:]), 0, mean, basis), described / size


def _describe_all(
    observation: np.ndarray, chosen: np.ndarray, settings: FeatureSettings, edges: torch.Tensor | None
) -> torch.Tensor:
    frequencies, values = settings.frequencies, settings.values
    size = describe(observation[:1], frequencies, edges).shape[1]
    described = torch.empty((len(chosen), size))
    for start in range(0, len(chosen), CHUNK):
        part = chosen[start : start + CHUNK]
        described[start : start + CHUNK] = describe(observation[part], frequencies, edges, values=values)
    return described


def _check_variety(centred: torch.Tensor, mean: torch.Tensor) -> None:
    apart, size = torch.linalg.vector_norm(centred), torch.linalg.vector_norm(mean) * len(centred) ** 0.5
    if apart <= MIN_VARIETY * size:
        raise InputError(f"all {len(centred)} observations look alike, so none tells where it was")


def _principal_axes(centred: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    # Randomised subspace iteration (Halko, Martinsson, Tropp 2011, algorithm 4.4).
    width = min(count + 16, *centred.shape)
    guess = torch.randn((centred.shape[1], width), generator=generator)
    for _ in range(3):
        guess, _ = torch.linalg.qr(centred.T @ (centred @ guess))
    _, _, axes = torch.linalg.svd(centred @ guess, full_matrices=False)
    return (guess @ axes.T)[:, :count]


def _describe_changes(
    observation: np.ndarray, chosen: np.ndarray, frequencies: int, generator: torch.Generator
) -> torch.Tensor:
    """What another light changes in the descriptions (n, K) of some of the chosen images."""
    some = chosen[:: -(-len(chosen) // RELIT_IMAGES)]
    changes = []
    for start in range(0, len(some), CHUNK):
        images = np.ascontiguousarray(observation[some[start : start + CHUNK]])
        seen, relit = (describe(one, frequencies, values="ranks") for one in (images, relight(images, generator)))
        changes.append(relit.sub_(seen))
    return torch.cat(changes)


def _slow_axes(x: torch.Tensor, segments: Segments, count: int, changed: torch.Tensor | None = None) -> torch.Tensor:
    # Besides what bends along segments, what light changes (n, K) counts as noise.
    x = x.double()
    triple = segments.valid[:, 2:]
    if triple.sum() < 2 * x.shape[1]:
        # Too few consecutive readings to separate slow from fast, as with two readings per segment.
        return torch.eye(x.shape[1])[:, :count]
    first, middle, last = (segments.index[:, k : k + triple.shape[1]][triple] for k in range(3))
    bend = x[first] - 2.0 * x[middle] + x[last]
    noise = bend.T @ bend / len(bend)
    if changed is not None:
        changed = changed.double()
        noise += LIGHT_WEIGHT * (changed.T @ changed) / len(changed)
    if not noise.any():
        return torch.eye(x.shape[1])[:, :count].float()  # no component bends, so none is slower than the others
    ridge = 1e-6 * noise.diagonal().mean() * torch.eye(len(noise), dtype=noise.dtype)
    ratio, axes = solve_generalised(x.T @ x / len(x), noise + ridge)
    # Each axis has bends of size 1; a fourth root of the ratio keeps the slowest first and damps what is nearly noise.
    return (axes * ratio.clamp_min(1e-12) ** 0.25).flip(1)[:, :count].float()


def solve_generalised(a: torch.Tensor, b: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Solve ``a v = w b v`` for symmetric a and positive b: w ascending, and v as columns with ``v.T b v = 1``."""
    lower = torch.linalg.cholesky(b)
    inner = torch.linalg.solve_triangular(lower, a, upper=False)
    inner = torch.linalg.solve_triangular(lower, inner.T, upper=False)
    w, v = torch.linalg.eigh((inner + inner.T) / 2.0)
    return w, torch.linalg.solve_triangular(lower.T, v, upper=True)


def rank_values(image: torch.Tensor) -> torch.Tensor:
    """Replace each value (N, ...), 0 to 255, of an image by the share of its values, of all colours, that are darker.

    Equal values share the mean of their ranks; the result is float32 between 0 and 255, with a mean of 127.5. Light,
    exposure and gamma change what a pixel's value is, and rarely which of two pixels is brighter. This is histogram
    equalisation (Hummel, "Image enhancement by histogram transformation", Computer Graphics and Image Processing 6(2),
    1977).
    """
    place = image.long().flatten(1)
    count = torch.zeros((len(place), 256)).scatter_add(1, place, torch.ones(place.shape))
    darker = (count.cumsum(dim=1) - count / 2) * (255.0 / place.shape[1])
    return darker.gather(1, place).view(image.shape)


GAIN_STD, COLOUR_GAIN_STD = 0.4, 0.1
"""Standard deviation of the logarithm of the light's gain, shared by the colours, and of what is each colour's own."""
WAVES, BENDS = 4, 2
"""Highest number of periods of a gain around the circle, and of half periods from the centre to the rim."""
DIMMING = 0.8  # Factor of all values, which leaves room for gains above 1
GAMMA = 2.2  # Pixel values grow with about this root of the light


def relight(images: np.ndarray, generator: torch.Generator) -> np.ndarray:
    """Copies of polar images (N, rings, sectors, colours) uint8, each under another random light."""
    count, rings, sectors, colours = images.shape
    waves = _make_waves(rings, sectors)
    shared = GAIN_STD * torch.randn((count, 1, len(waves)), generator=generator)
    own = COLOUR_GAIN_STD * torch.randn((count, colours, len(waves)), generator=generator)
    gain = ((shared + own) @ waves).div_(GAMMA).exp_().view(count, colours, rings, sectors).permute(0, 2, 3, 1)
    return (torch.from_numpy(images) * gain * DIMMING).round_().clamp_(0.0, 255.0).to(torch.uint8).numpy()


@lru_cache(maxsize=8)
def _make_waves(rings: int, sectors: int) -> torch.Tensor:
    """Waves around the circle and along the radius (W, rings * sectors), smoother ones larger; RMS 1 in total."""
    angle, radius = 2.0 * np.pi * np.arange(sectors) / sectors, (np.arange(rings) + 0.5) / rings
    made = []
    for wave in range(WAVES + 1):
        for bend in range(BENDS + 1):
            along = np.cos(np.pi * bend * radius)[:, None] / ((1.0 + wave / 2.0) * (1.0 + bend / 2.0))
            made += [along * np.cos(wave * angle), *([along * np.sin(wave * angle)] if wave else [])]
    waves = np.array(made).reshape(len(made), -1)
    return torch.from_numpy((waves / np.sqrt((waves**2).sum(axis=0).mean())).astype(np.float32))
