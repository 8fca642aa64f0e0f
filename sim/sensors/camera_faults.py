"""Faults of the camera that act on a finished image: linear light -> smear -> falloff -> exposure -> noise -> code.

As pure functions, like those of the encoders: a recording with such faults is made of the one without, and nothing is
drawn again. Values of an image are taken as sRGB (IEC 61966-2-1), as a camera's file would hold them; all faults act
on the linear light that they stand for. What the image without faults has cut off at white stays cut off.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sim.rng import stream
from sim.settings import ImageFaultSettings

Develop = Callable[[np.ndarray], np.ndarray]
"""Images (n, rings, sectors, 3) uint8 without faults -> the same with them, in the order in which they were taken."""
_STEPS = 65535  # of linear light, far finer than any step of the code


class CameraStreams(NamedTuple):
    """Chance of each kind and part, apart, so that one does not shift another, nor the drive's length the tests."""

    noise: np.random.Generator
    test_noise: np.random.Generator
    lean: np.random.Generator
    test_lean: np.random.Generator


def spawn_streams(seed: int) -> CameraStreams:
    """The camera's streams of chance under a scenario's seed."""
    return CameraStreams(*stream(seed, "camera").spawn(4))


def make_develop(settings: ImageFaultSettings, rng: np.random.Generator) -> Develop | None:
    """What turns images without faults into those of these settings; none where all are off.

    ``rng`` is drawn from once for each value, in order: the images of a shorter drive are the first of a longer one's.
    """
    if all(getattr(settings, name) == off for name, off in _OFF.items()):
        return None
    return lambda images: develop(images, settings, rng)


def develop(images: np.ndarray, settings: ImageFaultSettings, rng: np.random.Generator) -> np.ndarray:
    """Images (n, rings, sectors, 3) uint8 with all faults of the settings."""
    light = smear(decode(images), settings.turn_deg)
    light = light * (vignette(images.shape[1], settings.vignetting) * settings.exposure).astype(np.float32)
    if settings.read_noise or settings.shot_noise:
        light = add_noise(light, settings, rng)
    return encode(light)


def decode(images: np.ndarray) -> np.ndarray:
    """Linear light (...) float32, white is 1, of sRGB values (...) uint8."""
    return _TO_LIGHT[images]


def encode(light: np.ndarray) -> np.ndarray:
    """The nearest sRGB values (...) uint8 of linear light (...) float32, cut off at black and at white."""
    return _TO_CODE[(np.clip(light, 0.0, 1.0) * np.float32(_STEPS) + np.float32(0.5)).astype(np.uint16)]


def smear(light: np.ndarray, turn_deg: float) -> np.ndarray:
    """Light (n, rings, sectors, 3) while the camera turns evenly by an angle [deg], half of it before and after.

    Each pixel is the mean of what passes over it: the weight of the k-th to the side is the mean over s in [-w/2, w/2]
    of max(0, 1 - |k - s|), where w is the angle in sectors. The weights add up to 1: a ring keeps its mean.
    """
    width = turn_deg / 360.0 * light.shape[2]
    if width == 0.0:
        return light
    reach = int(np.ceil(width / 2 + 1.0))
    smeared = np.zeros_like(light)
    for aside in range(-reach, reach + 1):
        weight = (_ramp(aside + width / 2) - _ramp(aside - width / 2)) / width
        smeared += np.roll(light, aside, axis=2) * np.float32(weight)
    return smeared


def vignette(rings: int, lost: float) -> np.ndarray:
    """Factors (rings, 1, 1) by which light falls off to the rim, where the fraction ``lost`` is gone: cos^4 of an angle
    whose tangent grows with the image radius r, 1 / (1 + (r / f)^2)^2 (Kang and Weiss, "Can we calibrate a camera using
    an image of a flat, textureless Lambertian surface?", ECCV 2000); f is what gives 1 - lost at r = 1.
    """
    radius = (np.arange(rings) + 0.5) / rings
    return (1.0 + radius**2 * ((1.0 - lost) ** -0.5 - 1.0))[:, None, None] ** -2


def add_noise(light: np.ndarray, settings: ImageFaultSettings, rng: np.random.Generator) -> np.ndarray:
    """Light (n, rings, sectors, 3) with noise of variance (shot^2 light + read^2) / pixels, normal and independent.

    The variance of a sensor pixel is affine in its light (Foi et al., "Practical Poissonian-Gaussian noise modeling and
    fitting for single-image raw-data", IEEE TIP 17(10), 2008). A value of the polar image is the mean of the sensor
    pixels that it covers, few in the middle and many at the rim; their own cut-off and colour filters are left out.
    """
    pixels = count_sensor_pixels(light.shape[1], light.shape[2], settings.sensor_px)
    shot, read = ((noise**2 / pixels).astype(np.float32) for noise in (settings.shot_noise, settings.read_noise))
    return light + np.sqrt(light * shot + read) * rng.standard_normal(light.shape, dtype=np.float32)


def count_sensor_pixels(rings: int, sectors: int, sensor_px: int) -> np.ndarray:
    """Sensor pixels (rings, 1, 1) in one polar pixel of each ring: its area, but never less than one."""
    edge = np.linspace(0.0, 1.0, rings + 1)
    return np.maximum(np.pi * (sensor_px / 2) ** 2 * np.diff(edge**2) / sectors, 1.0)[:, None, None]


def _ramp(at: float) -> float:
    """Integral of max(0, 1 - |t|) from minus infinity to ``at``."""
    at = min(max(at, -1.0), 1.0)
    return 0.5 + at - np.copysign(at * at / 2, at)


def _srgb_to_light(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


_TO_LIGHT = _srgb_to_light(np.arange(256) / 255.0).astype(np.float32)
# between two values the nearer one in code, so that the step lies at the light of the code's half
_TO_CODE = np.searchsorted(_srgb_to_light((np.arange(255) + 0.5) / 255.0), np.arange(_STEPS + 1) / _STEPS).astype(
    np.uint8
)
_OFF = {name: field.default for name, field in ImageFaultSettings.model_fields.items() if name != "sensor_px"}
