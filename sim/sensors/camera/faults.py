"""Faults of the camera that act on a finished image: linear light -> smear -> mast -> falloff -> exposure -> noise.

They are pure functions, like those of the encoders: a recording with such faults is derived from the one without, and
nothing is rendered again. Image values are taken as sRGB (IEC 61966-2-1), as in a camera's files; all faults act on the
linear light that they encode. Light that the image without faults cuts off at white stays cut off. Glare and JPEG
compression are faults of the round image that the camera sends, before it is unwrapped.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from sim.rng import stream
from sim.sensors.catalog import Measure, Measures
from sim.settings import DeploymentImageFaultSettings, ImageFaultSettings, SimSettings

MIN_SMEAR_SECTORS = 1e-6  # A smear that is narrower than this, in sectors, is none
SENSOR_PX = 480
"""Diameter of the image's circle on the sensor [px]; a polar pixel is the mean of the sensor pixels it covers."""
MAST_LIGHT = 0.05  # Light of a mast that hides a part of the view, as a fraction of white
_STEPS = 65535  # steps of linear light, far finer than any sRGB step


def make_measures(settings: SimSettings, seed: int) -> Measures:
    """Return the functions that apply the faults to images, at test positions those in deployment."""
    faults = settings.image_faults
    deployed = faults.override(settings.deployment.image_faults)
    parts = {"noise": faults, "test_noise": deployed, "turn_noise": faults}
    return Measures(*(make_develop(some, stream(seed, "camera", name)) for name, some in parts.items()))


def drop_faults(settings: SimSettings) -> SimSettings:
    """The settings without faults of finished images, in training and in deployment."""
    deployed = settings.deployment.image_faults
    none = dict.fromkeys(_FAULTLESS_VALUES.keys() & DeploymentImageFaultSettings.model_fields.keys())
    deployment = settings.deployment.model_copy(update={"image_faults": deployed.model_copy(update=none)})
    faultless = settings.image_faults.model_copy(update=_FAULTLESS_VALUES)
    return settings.model_copy(update={"image_faults": faultless, "deployment": deployment})


def make_develop(settings: ImageFaultSettings, rng: np.random.Generator) -> Measure | None:
    """Return the function that applies the faults of these settings to images; None if all faults are off.

    One number is drawn from ``rng`` for each value, in order: a shorter drive has the first images of a longer one.
    """
    if all(getattr(settings, name) == off for name, off in _FAULTLESS_VALUES.items()):
        return None
    return lambda images: develop(images, settings, rng)


def develop(images: np.ndarray, settings: ImageFaultSettings, rng: np.random.Generator) -> np.ndarray:
    """Return images (n, rings, sectors, 3) uint8 with all faults of the settings."""
    light = decode(images)
    for fault in FAULTS:
        light = fault.apply(light, settings, rng)
    return encode(light)


def decode(images: np.ndarray) -> np.ndarray:
    """Linear light (...) float32, with white = 1, of sRGB values (...) uint8."""
    return _TO_LIGHT[images]


def encode(light: np.ndarray) -> np.ndarray:
    """The nearest sRGB values (...) uint8 of linear light (...) float32, cut off at black and at white."""
    return _TO_CODE[(np.clip(light, 0.0, 1.0) * np.float32(_STEPS) + np.float32(0.5)).astype(np.uint16)]


def smear(light: np.ndarray, turn_deg: float) -> np.ndarray:
    """Mean light (n, rings, sectors, 3) while the camera turns evenly by an angle [deg] about the image's heading.

    Each pixel is the mean of the light that passes over it: the weight of the k-th pixel to the side is the mean over s
    in [-w/2, w/2] of max(0, 1 - |k - s|), where w is the angle in sectors. The weights add up to 1: a ring keeps its
    mean.
    """
    width = turn_deg / 360.0 * light.shape[2]
    if width < MIN_SMEAR_SECTORS:
        return light
    reach = int(np.ceil(width / 2 + 1.0))
    smeared = np.zeros_like(light)
    for aside in range(-reach, reach + 1):
        weight = (_ramp(aside + width / 2) - _ramp(aside - width / 2)) / width
        smeared += np.roll(light, aside, axis=2) * np.float32(weight)
    return smeared


def hide(light: np.ndarray, hidden_deg: float) -> np.ndarray:
    """Light (n, rings, sectors, 3) with a dark mast behind the robot in whole sectors, as many as make the angle."""
    sectors = light.shape[2]
    count = round(hidden_deg / 360.0 * sectors)
    hidden = light.copy()
    hidden[:, :, (sectors - count) // 2 :][:, :, :count] = MAST_LIGHT
    return hidden


def vignette(rings: int, lost: float) -> np.ndarray:
    """Factors (rings, 1, 1) by which light falls off towards the rim, where the fraction ``lost`` is gone.

    This is cos^4 of an angle whose tangent grows with the image radius r, 1 / (1 + (r / f)^2)^2 (Kang and Weiss, "Can
    we calibrate a camera using an image of a flat, textureless Lambertian surface?", ECCV 2000); f is chosen so that
    the factor is 1 - lost at r = 1.
    """
    radius = (np.arange(rings) + 0.5) / rings
    return (1.0 + radius**2 * ((1.0 - lost) ** -0.5 - 1.0))[:, None, None] ** -2


def add_noise(light: np.ndarray, settings: ImageFaultSettings, rng: np.random.Generator) -> np.ndarray:
    """Return light (n, rings, sectors, 3) with independent normal noise of variance (shot^2 light + read^2) / pixels.

    The variance of a sensor pixel is affine in its light (Foi et al., "Practical Poissonian-Gaussian noise modeling and
    fitting for single-image raw-data", IEEE TIP 17(10), 2008). A value of the polar image is the mean of the sensor
    pixels that it covers, few in the middle and many at the rim; saturation and colour filters of the sensor pixels are
    not modelled.
    """
    pixels = count_sensor_pixels(light.shape[1], light.shape[2])
    shot, read = ((noise**2 / pixels).astype(np.float32) for noise in (settings.shot_noise, settings.read_noise))
    return light + np.sqrt(light * shot + read) * rng.standard_normal(light.shape, dtype=np.float32)


def count_sensor_pixels(rings: int, sectors: int) -> np.ndarray:
    """Sensor pixels (rings, 1, 1) in one polar pixel of each ring: its area, but never less than one."""
    edge = np.linspace(0.0, 1.0, rings + 1)
    return np.maximum(np.pi * (SENSOR_PX / 2) ** 2 * np.diff(edge**2) / sectors, 1.0)[:, None, None]


def _ramp(at: float) -> float:
    """Integral of max(0, 1 - |t|) from minus infinity to ``at``."""
    at = min(max(at, -1.0), 1.0)
    return 0.5 + at - np.copysign(at * at / 2, at)


def _srgb_to_light(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


_TO_LIGHT = _srgb_to_light(np.arange(256) / 255.0).astype(np.float32)
# round to the nearest sRGB value: each step is at the light of the half-way sRGB value
_TO_CODE = np.searchsorted(_srgb_to_light((np.arange(255) + 0.5) / 255.0), np.arange(_STEPS + 1) / _STEPS).astype(
    np.uint8
)


@dataclass(frozen=True)
class ImageFault:
    """A fault of finished images."""

    titles: Mapping[str, str]  # Wording of its settings in reports, each with a placeholder for the value
    # (linear light (n, rings, sectors, 3), settings, RNG stream) -> the light with this fault
    apply: Callable[[np.ndarray, ImageFaultSettings, np.random.Generator], np.ndarray]


def _add_noise(light: np.ndarray, settings: ImageFaultSettings, rng: np.random.Generator) -> np.ndarray:
    return add_noise(light, settings, rng) if settings.read_noise or settings.shot_noise else light


def _attenuate(light: np.ndarray, settings: ImageFaultSettings, rng: np.random.Generator) -> np.ndarray:
    return light * (vignette(light.shape[1], settings.vignetting) * settings.exposure).astype(np.float32)


FAULTS = (
    ImageFault(
        {"turn_deg": "turned {:g}° during exposure"}, lambda light, settings, rng: smear(light, settings.turn_deg)
    ),
    ImageFault(
        {"hidden_deg": "{:g}° of the view hidden"}, lambda light, settings, rng: hide(light, settings.hidden_deg)
    ),
    ImageFault({"vignetting": "vignetting {:g}", "exposure": "exposure x {:g}"}, _attenuate),
    ImageFault({"read_noise": "read noise {:g}", "shot_noise": "shot noise {:g}"}, _add_noise),
)
"""Faults in the order in which they act on the light."""
FACE_PX = 240  # Smallest side of the faces that it is drawn from: near the zenith a pixel is then 1.2 of a face's
BRIGHT_LIGHT, LAMP_LIGHT = 0.85, 30.0
"""Least light of a lamp or a window in an image, and what it is in truth, for an image ends at white; white = 1."""
SCATTERS = ((0.5, 1.5), (0.5, 16.0))
"""Scattered light: share, and standard deviation of the angle [deg]; a halo and a veil."""
COARSENESS = 4  # Pixels of the image, along each side, that are one in scattered light
RAW_TITLES = {"glare": "glare {:g}", "jpeg_kb": "JPEG of {:g} kB"}
"""Wording of the faults of the round image, as those above."""
_FAULTLESS_VALUES = {name: ImageFaultSettings.model_fields[name].default for fault in FAULTS for name in fault.titles}


def add_glare(light: np.ndarray, glare: float, px_per_deg: float) -> np.ndarray:
    """Linear light (px, px, 3) float32 of a round image, with a fraction of the light of lamps and windows scattered.

    Glare does not dim what scatters: what was white stays white.
    """
    bright = light.max(axis=2, keepdims=True) >= BRIGHT_LIGHT
    rows, columns = light.shape[0] // COARSENESS, light.shape[1] // COARSENESS
    lamps = cv2.resize(light * bright * np.float32(LAMP_LIGHT), (columns, rows), interpolation=cv2.INTER_AREA)
    blur = partial(cv2.GaussianBlur, lamps, (0, 0), borderType=cv2.BORDER_CONSTANT)
    scattered = np.sum([share * blur(sigmaX=deg * px_per_deg / COARSENESS) for share, deg in SCATTERS], axis=0)
    return light + np.float32(glare) * cv2.resize(scattered, light.shape[1::-1], interpolation=cv2.INTER_LINEAR)


def compress(image: np.ndarray, jpeg_kb: float) -> np.ndarray:
    """JPEG file (n,) uint8 of an image (px, px, 3) uint8, at the best quality whose file is no larger [kB].

    The file at the least quality, if even that is larger.
    """
    low, high = 1, 101
    file = _encode_jpeg(image, low)
    while high - low > 1:
        middle = (low + high) // 2
        tried = _encode_jpeg(image, middle)
        if len(tried) <= 1000 * jpeg_kb:
            low, file = middle, tried
        else:
            high = middle
    return file


def _encode_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
