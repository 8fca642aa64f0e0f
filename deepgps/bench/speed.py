"""Speed of positioning from polar images, and how little positions move when the robot turns."""

import time
from collections.abc import Callable

import numpy as np
import torch
from scipy.stats import rankdata

from deepgps.bench.rows import Row
from deepgps.learning.trainer import use_threads
from deepgps.positioner.positioner import NetworkPositioner, Positioner

BATCH = 500


def measure_speed(positioner: NetworkPositioner, images: np.ndarray, repeats: int) -> list[Row]:
    """Measure the time of one position and positions per second, on one core, alternating with the naive version.

    Args:
        positioner: A trained spectral network.
        images: Raw polar images (n, rings, sectors, 3) uint8; all of them are positioned at once to measure the rate.
        repeats: Number of timings of all images; single images are timed forty times as often.
    """
    ways = {"ours": positioner, "naive": lambda images: locate_naively(positioner, images)}
    with use_threads(1):
        one = {name: [] for name in ways}
        for number in range(40 * repeats):
            image = images[number % len(images)][None]
            for name, way in ways.items():
                one[name].append(_time(way, image))
        many = {name: [] for name in ways}
        for _ in range(repeats):
            for name, way in ways.items():
                many[name].append(_time(way, images) / len(images))
    single = {name: 1e3 * float(np.median(each)) for name, each in one.items()}
    rate = {name: 1.0 / float(np.median(each)) for name, each in many.items()}
    slow = (
        f"one core; 95 of 100 within {1e3 * float(np.percentile(one['ours'], 95)):.2f} ms; naive: a Fourier transform"
    )
    return [
        Row("latency", "a position from one polar image", single["ours"], "ms", 1.0, naive=single["naive"], note=slow),
        Row("rate", f"positions, {BATCH} at once", rate["ours"], "/s", 10_000, True, rate["naive"], "one core"),
    ]


def locate_naively(positioner: NetworkPositioner, images: np.ndarray) -> np.ndarray:
    """Positions (n, 2) [m] of images (n, ...) by the formulas as written, without optimisation."""
    features = positioner.features
    assert features is not None
    found = [np.zeros((0, 2))]
    for start in range(0, len(images), BATCH):
        some = images[start : start + BATCH].astype(np.float32) / 255.0
        if features.values == "ranks":
            flat = some.reshape(len(some), -1)
            some = ((rankdata(flat, axis=1) - 0.5) / flat.shape[1]).astype(np.float32).reshape(some.shape)
        image = torch.from_numpy(np.ascontiguousarray(some.transpose(0, 1, 3, 2)))
        spectrum = torch.fft.rfft(image, norm="forward")[..., : features.frequencies + 1]
        product = spectrum[:, :-1, :, 1:] * spectrum[:, 1:, :, 1:].conj()
        product = product / (product.abs() + 1e-8) ** 0.75
        described = torch.cat([spectrum.abs().sqrt().flatten(1), torch.view_as_real(product).flatten(1)], dim=1)
        out = positioner.network((described - features.mean) @ features.basis).detach()
        found.append(((out - positioner.centre).double() @ positioner.axes.double()).numpy())
    return np.concatenate(found)


def measure_spread(positioner: Positioner, images: np.ndarray) -> tuple[float, float]:
    """Distance of predictions at one place from their mean: RMS and maximum over places and headings [m].

    Args:
        positioner: The positioner to measure.
        images: Images at each place and heading (P, H, ...).
    """
    places, headings = images.shape[:2]
    found = positioner(images.reshape(places * headings, *images.shape[2:])).reshape(places, headings, 2)
    away = np.linalg.norm(found - found.mean(axis=1, keepdims=True), axis=-1)
    return float(np.sqrt(np.mean(away**2))), float(away.max())


def _time(way: Callable[[np.ndarray], np.ndarray], images: np.ndarray) -> float:
    start = time.perf_counter()
    way(images)
    return time.perf_counter() - start
