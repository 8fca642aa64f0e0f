"""Relative headings: exact for a turned image, and a drive that bends is seen to bend."""

import numpy as np
import torch

from deepgps.data.segments import Segments
from deepgps.data.turns import compare_headings, measure_curvature

SECTORS = 64


def draw(seed: int, count: int) -> np.ndarray:
    """Smooth polar images (count, 16, SECTORS, 3)."""
    rng = np.random.default_rng(seed)
    wave = np.arange(1, 9)
    phase = 2 * np.pi * np.arange(SECTORS)[:, None] / SECTORS * wave
    shares = rng.normal(size=(2, count, 16, 8, 3))
    images = np.einsum("sw,nrwc->nrsc", np.cos(phase), shares[0]) + np.einsum("sw,nrwc->nrsc", np.sin(phase), shares[1])
    return (128 + 8 * images).clip(0, 255).astype(np.uint8)


def test_a_turned_image_tells_the_turn_at_every_sector():
    image = draw(0, 1)
    turned = np.concatenate([np.roll(image, -k, axis=2) for k in range(SECTORS)])
    found = compare_headings(turned, np.zeros(SECTORS, int), np.arange(SECTORS))
    true = 2 * np.pi * np.arange(SECTORS) / SECTORS
    assert found.clear.all()
    np.testing.assert_allclose(np.angle(np.exp(1j * (found.turn - true))), 0.0, atol=np.radians(0.2))


def test_an_image_with_two_fold_symmetry_leaves_the_heading_open():
    half = draw(1, 1)[:, :, : SECTORS // 2]
    found = compare_headings(np.concatenate([half, half], axis=2), np.zeros(1, int), np.zeros(1, int))
    assert not found.clear.any()


def test_the_curvature_of_a_drive_is_its_turn_for_each_metre():
    image = draw(2, 1)
    images = np.concatenate([np.roll(image, -k, axis=2) for k in range(6)])  # a sector for each step of 0.5 m
    index = torch.arange(6)[None]
    segments = Segments(index, 0.5 * index.float(), torch.tensor([6]), 0)
    assert abs(measure_curvature(images, segments) - 2 * np.pi / SECTORS / 0.5) < 0.01
