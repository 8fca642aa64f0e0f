"""Laws of the faults of finished images: what off means, what noise adds, what composes, what keeps what."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.rng import stream
from sim.sensors.camera.faults import (
    FAULTS,
    MAST_LIGHT,
    add_noise,
    count_sensor_pixels,
    decode,
    develop,
    encode,
    hide,
    make_develop,
    smear,
    vignette,
)
from sim.settings import ImageFaultSettings, SimSettings

RINGS, SECTORS = 8, 32
ALL_CODES = np.arange(256, dtype=np.uint8)
FAULTY_VALUES = dict(exposure=0.7, vignetting=0.4, read_noise=0.3, shot_noise=0.6, turn_deg=9.0, hidden_deg=135.0)
FAULTY_SETTINGS = ImageFaultSettings(**FAULTY_VALUES)


def draw_images(count: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (count, RINGS, SECTORS, 3), dtype=np.uint8)


def draw_light(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((2, RINGS, SECTORS, 3), dtype=np.float32)


def test_light_is_that_of_srgb_and_comes_back_as_the_same_code():
    light = decode(ALL_CODES)
    assert light[[0, 255]].tolist() == [0.0, 1.0]
    assert light[[10, 128, 188]] == pytest.approx([0.0030353, 0.2158605, 0.5028865], rel=1e-5)  # IEC 61966-2-1, by hand
    assert (np.diff(light) > 0).all()
    np.testing.assert_array_equal(encode(light), ALL_CODES)
    assert encode(np.array([-0.5, 1.5], np.float32)).tolist() == [0, 255]


def test_the_code_is_the_nearest_one():
    light = np.linspace(0.0, 1.0, 4001, dtype=np.float32)
    exact = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055) * 255
    assert np.abs(encode(light) - exact).max() <= 0.53  # half a code, and the table's own steps


def test_what_is_off_changes_nothing():
    assert make_develop(ImageFaultSettings(), np.random.default_rng(0)) is None
    images = draw_images()
    np.testing.assert_array_equal(develop(images, ImageFaultSettings(), np.random.default_rng(0)), images)


def test_each_fault_is_one():
    assert FAULTY_VALUES.keys() == {name for fault in FAULTS for name in fault.titles}
    for name, strength in FAULTY_VALUES.items():
        fault_of = make_develop(ImageFaultSettings(**{name: strength}), np.random.default_rng(0))
        assert fault_of is not None
        assert (fault_of(draw_images()) != draw_images()).mean() > 0.3


def test_same_seed_same_bytes_however_many_at_a_time_and_other_seed_others():
    images = draw_images(10)
    whole = develop(images, FAULTY_SETTINGS, stream(5, "noise"))
    piecewise = make_develop(FAULTY_SETTINGS, stream(5, "noise"))
    assert piecewise is not None
    parts = [piecewise(part) for part in np.split(images, [1, 4])]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    np.testing.assert_array_equal(develop(images[:4], FAULTY_SETTINGS, stream(5, "noise")), whole[:4])
    others = (stream(6, "noise"), stream(5, "test"))
    assert all((develop(images, FAULTY_SETTINGS, other) != whole).mean() > 0.1 for other in others)


def test_noise_has_the_mean_and_variance_of_its_formula():
    pixels = [np.pi * 240**2 * (outer**2 - inner**2) / 8 for inner, outer in pairwise(np.arange(5) / 4)]
    for (read, shot), grey in product([(0.2, 0.0), (0.0, 0.4), (0.16, 0.32)], [0.05, 0.4]):
        settings = ImageFaultSettings(read_noise=read, shot_noise=shot)
        noisy = add_noise(np.full((2000, 4, 8, 3), grey, np.float32), settings, np.random.default_rng(1))
        variance = (shot**2 * grey + read**2) / np.array(pixels)
        assert noisy.var(axis=(0, 2, 3)) == pytest.approx(variance, rel=0.03)
        assert noisy.mean(axis=(0, 2, 3)) == pytest.approx(grey, abs=4 * np.sqrt(variance.max() / 48_000))


def test_noise_of_neighbours_and_channels_is_their_own():
    light = np.full((4000, 1, 8, 3), 0.5, np.float32)
    noise = add_noise(light, ImageFaultSettings(read_noise=0.1), np.random.default_rng(2)) - light
    assert np.corrcoef(noise.reshape(4000, -1).T) - np.eye(24) == pytest.approx(0.0, abs=0.08)


def test_all_sensor_pixels_are_counted_and_none_is_split():
    assert count_sensor_pixels(32, 128).sum() * 128 == pytest.approx(np.pi * 240**2)
    assert count_sensor_pixels(512, 1024).min() == 1.0


@given(st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_exposures_compose_where_nothing_is_cut_off(one: float, other: float):
    images = draw_images(1)
    both = develop(images, ImageFaultSettings(exposure=one * other), np.random.default_rng(0)).astype(int)
    first = develop(images, ImageFaultSettings(exposure=one), np.random.default_rng(0))
    second = develop(first, ImageFaultSettings(exposure=other), np.random.default_rng(0))
    # the first image is rounded to whole codes: at black one of them is nearly that of the second
    assert np.abs(both - second).max() <= 1
    assert (both <= first).all()


def test_a_longer_exposure_is_brighter_until_white():
    images = draw_images()
    twice = develop(images, ImageFaultSettings(exposure=2.0), np.random.default_rng(0))
    assert (twice >= images).all()
    assert (twice[decode(images) >= 0.5] == 255).all()
    np.testing.assert_allclose(decode(twice[decode(images) < 0.5]), 2 * decode(images[decode(images) < 0.5]), atol=5e-3)


@given(st.integers(0, SECTORS - 1), st.floats(0.0, 0.99))
def test_vignetting_does_not_see_a_turn(sectors: int, lost: float):
    images, settings, rng = draw_images(), ImageFaultSettings(vignetting=lost), np.random.default_rng(0)
    turned = develop(np.roll(images, sectors, axis=2), settings, rng)
    np.testing.assert_array_equal(turned, np.roll(develop(images, settings, rng), sectors, axis=2))


def test_vignetting_is_cos4_from_all_in_the_middle_to_what_is_left_at_the_rim():
    np.testing.assert_array_equal(vignette(64, 0.0), 1.0)
    factor = vignette(1000, 0.6).ravel()
    assert factor[[0, -1]] == pytest.approx([1.0, 0.4], abs=1e-3)
    assert (np.diff(factor) < 0).all()
    rim = np.arccos(0.4**0.25)
    at = (np.arange(1000) + 0.5) / 1000
    np.testing.assert_allclose(factor, np.cos(np.arctan(at * np.tan(rim))) ** 4)


@given(st.floats(0.1, 90.0))
def test_smearing_keeps_the_mean_of_each_ring(turn_deg: float):
    light = draw_light()
    smeared = smear(light, turn_deg)
    np.testing.assert_allclose(smeared.mean(axis=2), light.mean(axis=2), atol=1e-5)
    assert smeared.std() < light.std()


def test_smearing_is_the_mean_of_many_turned_images():
    light, turn_deg = draw_light().astype(float), 40.0
    width = turn_deg / 360 * SECTORS
    turned = []
    for shift in (np.arange(2000) + 0.5) / 2000 * width - width / 2:  # turned by parts of a sector: linear in between
        whole, part = int(np.floor(shift)), shift - np.floor(shift)
        turned.append((1 - part) * np.roll(light, whole, axis=2) + part * np.roll(light, whole + 1, axis=2))
    np.testing.assert_allclose(smear(light.astype(np.float32), turn_deg), np.mean(turned, axis=0), atol=1e-5)


def test_no_turn_smears_nothing_and_a_little_one_hardly():
    light = draw_light()
    np.testing.assert_array_equal(smear(light, 0.0), light)
    for turn_deg in (0.01, 1e-13, 1e-16):
        np.testing.assert_allclose(smear(light, turn_deg), light, atol=1e-3)


@given(st.integers(1, SECTORS // 2))
def test_a_mast_hides_whole_sectors_behind_the_robot_and_changes_no_other(count: int):
    light = draw_light()
    hidden = hide(light, 360.0 * count / SECTORS)
    covered = (hidden == np.float32(MAST_LIGHT)).all(axis=(0, 1, 3))
    assert covered.sum() == count and abs(np.flatnonzero(covered).mean() - (SECTORS - 1) / 2) <= 0.5
    np.testing.assert_array_equal(hidden[:, :, ~covered], light[:, :, ~covered])


def test_faults_that_are_off_are_not_written_so_that_recordings_keep_their_digest():
    deployment = {"image_faults": {}, "person": False, "camera_mount": {"wobble_deg": None}}
    faults = dict.fromkeys(("hidden_deg", "glare", "jpeg_kb"), 0.0)
    off = SimSettings.model_validate({"image_faults": faults, "drive": {"person": 0}, "deployment": deployment})
    assert not any(name in off.model_dump_json() for name in (*faults, 'wobble_deg":null', '"person":0'))
    on = off.model_validate({"drive": {"person": 1}, "deployment": {"image_faults": {"glare": 0.0}, "person": 3}})
    assert SimSettings.model_validate_json(on.model_dump_json()) == on
