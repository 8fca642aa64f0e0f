"""Fit of the rotation between two polar images, robust, with the standard deviation that its residual allows.

Second image (azimuth, zenith angle) = first image at the ray turned by Rz(angle) swing(lean). The angle alone would do
for an upright camera in one place. The relative lean is fitted too, for two reasons: a camera wobbles, and parallax
between two places a few centimetres apart moves the image much as a lean does. Cauchy weights leave out what is close
or hidden.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from scipy import fft

from sim.sensors.camera.lens import Lens, polar_rays

CUTOFF = 0.31  # Above this many cycles per sector, aliasing dominates: the filter is exp(-(k / (CUTOFF sectors))^2)
HIGH_PASS_CYCLES = 6.0  # Slow changes of light are suppressed by k / (k + HIGH_PASS_CYCLES), k in cycles per turn
BLOCKS = 32  # Errors of neighbouring sectors are correlated, within about this fraction of the circle
MIN_STD_SECTORS = 0.01  # Aliasing that two images share does not show in their difference
STD_FACTOR = 1.25
"""Factor on standard deviations, from rendered pairs: the derivatives are themselves measured, with errors."""
MAX_COT = 2.0  # Limit of the cotangent of half the turn in the error that a lean of the camera leaves
STEPS = (2, 2, 3)  # Reweighted solutions after each linearisation
_MIN_ZENITH_SINE = 0.1  # least sine of the zenith angle in the field of a lean, which is singular there


class Fitted(NamedTuple):
    """Rotation from the first to the second image of M pairs."""

    angle: np.ndarray  # Angle turned to the left (M,) [rad]
    std: np.ndarray  # Its standard deviation (M,) [rad]
    lean: np.ndarray  # Lean of the second camera against the first, to the second's right and forward (M, 2) [rad]


@dataclass(frozen=True, eq=False)
class Grid:
    """What depends on the size of the polar image and its lens alone."""

    lens: Lens  # The lens
    rays: np.ndarray  # Directions of the pixels (rings, sectors, 3)
    per_radian: np.ndarray  # One over the zenith angle between a ring's neighbours (rings, 1) [1 / rad]
    weight: np.ndarray  # Solid angle of a pixel, up to a factor (rings, 1)
    # Azimuth and zenith angle by which pixels move per unit of angle and lean, both (3, rings, sectors)
    flow: tuple[np.ndarray, np.ndarray]
    filter: np.ndarray  # Factor of each frequency around the circle (sectors // 2 + 1,)


@lru_cache(maxsize=4)
def make_grid(rings: int, sectors: int, lens: Lens) -> Grid:
    """Return the grid of polar images of this size."""
    rays = polar_rays(lens, rings, sectors)
    x, y, z = np.moveaxis(rays, -1, 0)
    across = np.hypot(x, y)
    cos, sin, cot = x / across, y / across, z / np.maximum(across, _MIN_ZENITH_SINE)
    azimuth = np.array([np.ones_like(cos), -cot * cos, -cot * sin])
    zenith = np.array([np.zeros_like(cos), -sin, cos])
    ring = lens.angle((np.arange(rings) + 0.5) / rings)
    neighbours = np.clip(np.arange(rings) + [[-1], [1]], 0, rings - 1)
    frequency = np.arange(sectors // 2 + 1)
    passed = np.exp(-((frequency / (CUTOFF * sectors)) ** 2)) * frequency / (frequency + HIGH_PASS_CYCLES)
    passed[-1] *= sectors % 2  # the highest frequency of an even number of sectors has no phase
    return Grid(
        lens,
        rays.astype(np.float32),
        (1.0 / np.diff(ring[neighbours], axis=0)[0])[:, None].astype(np.float32),
        across[:, :1].astype(np.float32),
        (azimuth.astype(np.float32), zenith.astype(np.float32)),
        passed.astype(np.float32),
    )


def take_spectra(images: np.ndarray, grid: Grid) -> np.ndarray:
    """Spectra (P, channels, rings, sectors // 2 + 1) around the circle of images (P, rings, sectors, channels).

    They are smoothed across rings, and filtered.
    """
    padded = np.pad(np.moveaxis(images, 3, 1).astype(np.float32), ((0, 0), (0, 0), (1, 1), (0, 0)), mode="edge")
    smooth = (padded[:, :, :-2] + 2.0 * padded[:, :, 1:-1] + padded[:, :, 2:]) / 4.0
    return _transform(smooth) * grid.filter


def sample_spectra(spectra: np.ndarray, count: int) -> np.ndarray:
    """Values (..., count) around the circle of spectra (..., frequencies); SciPy is three times as fast as NumPy."""
    return np.asarray(fft.irfft(spectra, count))


def _transform(values: np.ndarray) -> np.ndarray:
    return np.asarray(fft.rfft(values))


def fit_rotation(first: np.ndarray, second: np.ndarray, angle: np.ndarray, grid: Grid) -> Fitted:
    """Fit the rotation of M pairs of spectra (M, channels, rings, frequencies) by Gauss-Newton with Cauchy weights.

    These are scaled by the residual's RMS. It begins at angles (M,) [rad] within about a sector. The covariance is the
    sandwich of Huber ("Robust statistics", 1981, sec. 7.6), with scores summed over blocks of neighbouring sectors
    (Newey and West, Econometrica 55(3), 1987), since they are correlated.
    """
    sectors = grid.rays.shape[1]
    other = sample_spectra(second, sectors)
    lean = np.zeros((len(angle), 2))
    for steps in STEPS:
        seen, weight = _turn(first, angle, lean, grid)
        maps = _linearise(seen, other, grid)
        step = np.zeros((len(angle), 3), np.float32)
        for _ in range(steps):
            step = _solve(maps, weight * _cauchy(maps, weight, step, grid)[0], grid)
        angle, lean = angle + step[:, 0], lean + step[:, 1:]
    least = MIN_STD_SECTORS * 2.0 * np.pi / sectors
    std = np.sqrt(_deviate(maps, weight, step, grid) ** 2 + twist(angle, lean) ** 2 + least**2)
    return Fitted(angle, std, lean)


def swing(lean: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about the horizontal vectors ``lean`` (..., 2): right and forward [rad] (Rodrigues)."""
    right, ahead = np.moveaxis(lean, -1, 0)
    zero = np.zeros_like(right)
    cross = np.stack([zero, zero, ahead, zero, zero, -right, -ahead, right, zero], axis=-1).reshape(*right.shape, 3, 3)
    size = np.hypot(right, ahead)[..., None, None]
    return np.eye(3) + np.sinc(size / np.pi) * cross + np.sinc(size / (2.0 * np.pi)) ** 2 / 2.0 * (cross @ cross)


def twist(angle: np.ndarray, lean: np.ndarray) -> np.ndarray:
    """Error (...) [rad] of the angle (...) if the relative lean is due to one lean l of the camera in both images.

    Then Rz(angle) swing(lean) = swing(l)^T Rz(turn) swing(l). To second order the angle differs from the turn by
    l^2 / 2 sin(turn), and the relative lean is 2 l sin(turn / 2). The quotient is limited: at small turns images
    wobble.
    """
    cot = np.abs(np.cos(angle / 2.0)) / np.maximum(np.abs(np.sin(angle / 2.0)), 1e-9)
    return (lean**2).sum(axis=-1) / 4.0 * np.minimum(cot, MAX_COT)


class _Maps(NamedTuple):
    """Sums over channels of products of the derivatives by azimuth and zenith angle, and the difference (M, R, S)."""

    aa: np.ndarray
    az: np.ndarray
    zz: np.ndarray
    ad: np.ndarray
    zd: np.ndarray
    dd: np.ndarray


def _turn(spectra: np.ndarray, angle: np.ndarray, lean: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Images (M, C, R, S) seen after a rotation, and weights (M, R, S) that are zero where the rim hides them."""
    rings, sectors = grid.rays.shape[:2]
    weight = np.broadcast_to(grid.weight, (len(angle), rings, sectors))
    turned = spectra * np.exp(1j * np.outer(angle, np.arange(spectra.shape[3]))).astype(np.complex64)[:, None, None]
    if not lean.any():
        return sample_spectra(turned, sectors), weight
    x, y, z = np.moveaxis(swing(lean).astype(np.float32) @ grid.rays.reshape(-1, 3).T, 1, 0).reshape(
        3, len(lean), rings, sectors
    )
    row = (grid.lens.radius(np.arccos(np.clip(z, -1.0, 1.0))) * rings - 0.5).astype(np.float32)
    column = (np.arctan2(y, x) * np.float32(sectors / np.pi) - 1.0) % np.float32(2 * sectors)
    fine = 2.0 * sample_spectra(turned, 2 * sectors)  # finer, since bilinear sampling smooths
    fine = np.ascontiguousarray(np.concatenate([fine, fine[..., :1]], axis=3).transpose(0, 2, 3, 1))
    inside = np.clip(row, 0.0, rings - 1.0)
    seen = [cv2.remap(*one, cv2.INTER_LINEAR) for one in zip(fine, column, inside, strict=True)]
    shape = len(lean), rings, sectors, -1
    return np.ascontiguousarray(np.moveaxis(np.reshape(seen, shape), 3, 1)), weight * (row < rings)


def _linearise(seen: np.ndarray, other: np.ndarray, grid: Grid) -> _Maps:
    """Products of the derivatives of both images' mean and of their difference, at equal contrast."""
    energy = [np.einsum("mcrs,mcrs->m", one, one) for one in (other, seen)]
    root = (np.divide(*np.maximum(energy, 1e-6)) ** 0.25).astype(np.float32)[:, None, None, None]
    seen, other = seen * root, other / root
    mean, difference = (seen + other) / 2.0, other - seen
    spectrum = _transform(mean)
    spectrum *= 1j * np.arange(spectrum.shape[3], dtype=np.float32)
    azimuth = sample_spectra(spectrum, mean.shape[3])
    zenith = np.empty_like(mean)
    np.subtract(mean[:, :, 2:], mean[:, :, :-2], out=zenith[:, :, 1:-1])
    zenith[:, :, 0], zenith[:, :, -1] = mean[:, :, 1] - mean[:, :, 0], mean[:, :, -1] - mean[:, :, -2]
    zenith *= grid.per_radian
    pairs = ((azimuth, azimuth), (azimuth, zenith), (zenith, zenith))
    pairs += ((azimuth, difference), (zenith, difference), (difference, difference))
    return _Maps(*(np.einsum("mcrs,mcrs->mrs", one, two) for one, two in pairs))


def _cauchy(
    maps: _Maps, weight: np.ndarray, step: np.ndarray, grid: Grid
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cauchy weights (M, R, S), scale (M, 1, 1), and derivatives times residual by azimuth and by zenith angle."""
    u, v = (np.tensordot(step.astype(np.float32), flow, 1) for flow in grid.flow)
    along, across = maps.ad - u * maps.aa - v * maps.az, maps.zd - u * maps.az - v * maps.zz
    square = np.maximum(maps.dd - u * (maps.ad + along) - v * (maps.zd + across), 0.0)
    scale = (weight * square).sum(axis=(1, 2), keepdims=True) / weight.sum(axis=(1, 2), keepdims=True) + 1e-9
    return scale / (scale + square), scale, along, across


def _gram(aa: np.ndarray, az: np.ndarray, zz: np.ndarray, grid: Grid) -> np.ndarray:
    (a, z), count = grid.flow, len(aa)
    cross = a[:, None] * z[None]
    bases = a[:, None] * a[None], cross + cross.swapaxes(0, 1), z[:, None] * z[None]
    total = sum(
        one.reshape(count, a[0].size) @ basis.reshape(9, -1).T for one, basis in zip((aa, az, zz), bases, strict=True)
    )
    return np.asarray(total, float).reshape(count, 3, 3) + 1e-12 * np.eye(3)


def _solve(maps: _Maps, weight: np.ndarray, grid: Grid) -> np.ndarray:
    """Angle and lean (M, 3) [rad] of least weighted squares."""
    matrix = _gram(weight * maps.aa, weight * maps.az, weight * maps.zz, grid)
    flat = ((weight * one).reshape(len(weight), grid.flow[0][0].size) for one in (maps.ad, maps.zd))
    right = sum(one @ flow.reshape(3, -1).T for one, flow in zip(flat, grid.flow, strict=True))
    return np.linalg.solve(matrix, np.asarray(right, float)[..., None])[..., 0]


def _deviate(maps: _Maps, weight: np.ndarray, step: np.ndarray, grid: Grid) -> np.ndarray:
    """Standard deviation of the angle (M,) [rad]."""
    cauchy, scale, along, across = _cauchy(maps, weight, step, grid)
    inner, drop = weight * cauchy, 2.0 * weight * cauchy**2 / scale
    bread = _gram(
        inner * maps.aa - drop * along**2,
        inner * maps.az - drop * along * across,
        inner * maps.zz - drop * across**2,
        grid,
    )
    score = np.einsum("mrs,nrs->msn", inner * along, grid.flow[0]) + np.einsum(
        "mrs,nrs->msn", inner * across, grid.flow[1]
    )
    length = max(score.shape[1] // BLOCKS, 1)
    block = sum(np.roll(score, shift, axis=1) for shift in range(length))
    meat = np.einsum("msi,msj->mij", block, block).astype(float) / length
    row = np.linalg.inv(bread)[:, 0]
    return STD_FACTOR * np.sqrt(np.einsum("mi,mij,mj->m", row, meat, row))
