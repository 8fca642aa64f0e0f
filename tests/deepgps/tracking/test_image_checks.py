"""Checks of single images: limits of training images, light, noise, and which images the wheels moved between."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.tracking.image_checks import (
    BLOCKS,
    ImageLimits,
    check_images,
    find_driven,
    find_limits,
    measure_images,
    take_blocks,
)
from sim.recording.format import Recording, open_recording


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


@pytest.fixture(scope="module")
def limits(recording: Recording) -> ImageLimits:
    return find_limits(recording)


def test_training_images_and_dimmed_ones_have_no_fault(recording: Recording, limits: ImageLimits):
    for gain in (0.4, 0.7, 1.0):
        found = check_images((gain * recording.observation).astype(np.uint8), find_driven(recording), limits)
        assert not any(part.any() for part in found.values())


def test_uniform_images_with_noise_are_named(recording: Recording, limits: ImageLimits):
    shape = (50, *recording.observation.shape[1:])
    for name, level in (("black", 0.0), ("white", 252.0), ("covered", 70.0)):
        images = np.clip(level + np.random.default_rng(0).normal(0.0, 1.5, shape), 0, 255).astype(np.uint8)
        found = check_images(images, np.zeros(50, bool), limits)
        assert found[name].all() and not found["frozen"].any()


def test_an_image_is_frozen_only_while_the_wheels_move(recording: Recording, limits: ImageLimits):
    images, moved = recording.observation.copy(), find_driven(recording)
    images[100:140] = images[100] + np.random.default_rng(0).integers(0, 2, (40, *images.shape[1:])).astype(np.uint8)
    frozen = check_images(images, moved, limits)["frozen"]
    assert frozen[101:140].tolist() == moved[101:140].tolist()
    assert moved[101:140].sum() > 20
    assert frozen.sum() == moved[101:140].sum()


def test_images_beside_turns_and_of_wheels_that_rest_have_not_moved(recording: Recording):
    moved = find_driven(recording)
    first = recording.reading[np.diff(recording.reading[:, 0], prepend=-1) != 0, 1]
    assert not moved[first[0]]
    assert moved.mean() > 0.8
    resting = replace(recording, reading=recording.reading * [1, 1, 0, 0])
    assert not find_driven(resting).any()


def test_blocks_are_means_of_any_image():
    rng = np.random.default_rng(0)
    for rings, sectors in ((8, 32), (32, 128), (9, 50), (4, 8)):
        grey = rng.random((3, rings, sectors)).astype(np.float32)
        blocks = take_blocks(grey)
        assert blocks.shape == (3, min(BLOCKS[0], rings), min(BLOCKS[1], sectors))
        assert blocks[0, 0, 0] == pytest.approx(
            grey[0, : rings // blocks.shape[1] or 1, : sectors // blocks.shape[2] or 1].mean(), abs=1e-5
        )
    assert measure_images(np.zeros((2, 8, 32, 3), np.uint8)).shape == (4, 2)
