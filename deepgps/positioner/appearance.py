"""What is seen where on a map: registers observations, and is stored with every method that compares features."""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from pydantic import TypeAdapter

from deepgps.config.learning import FeatureSettings
from deepgps.data.features import Features, check_shape
from deepgps.positioner.kriging import Kernel
from deepgps.positioner.pixels import KnownPixels, grey
from deepgps.positioner.registration import Calibration, Registered, Registration

CHUNK = 64
ARRAYS = ("known", "places", "place_std")


class Packed(NamedTuple):
    """Tensors by name, and what JSON holds, of which a positioner is made again."""

    tensors: dict[str, torch.Tensor]
    numbers: dict[str, Any]

    def take(self, name: str) -> "Packed":
        """The part that was packed by this name."""
        start = f"{name}."
        tensors = {key.removeprefix(start): one for key, one in self.tensors.items() if key.startswith(start)}
        return Packed(tensors, self.numbers[name])

    def add(self, name: str, part: "Packed") -> "Packed":
        """The same with another part by this name."""
        tensors = {f"{name}.{key}": one for key, one in part.tensors.items()}
        return Packed(self.tensors | tensors, self.numbers | {name: part.numbers})


def pack_features(features: Features) -> Packed:
    """The map to features."""
    tensors = {"mean": features.mean, "basis": features.basis}
    if features.edges is not None:
        tensors["edges"] = features.edges
    return Packed(
        tensors, {"shape": list(features.shape), "frequencies": features.frequencies, "values": features.values}
    )


def unpack_features(packed: Packed) -> Features:
    """The map to features that was packed; raises KeyError where a part is missing."""
    tensors, numbers = packed
    values = FeatureSettings(values=numbers["values"]).values
    mean, basis, edges = tensors["mean"], tensors["basis"], tensors.get("edges")
    return Features(tuple(numbers["shape"]), numbers["frequencies"], mean, basis, edges, values)


@dataclass(frozen=True)
class AppearanceMap:
    """Registers upright observations by their features and pixels."""

    features: Features  # The map from observations to whitened features
    registration: Registration

    def register(self, observations: np.ndarray) -> Registered:
        """Register observations (B, ...)."""
        check_shape(observations, self.features.shape)
        starts = range(0, max(len(observations), 1), CHUNK)
        found = [self._register(observations[start : start + CHUNK]) for start in starts]
        parts = ([getattr(one, name) for one in found] for name in Registered.__dataclass_fields__)
        return Registered(*(np.concatenate(part) for part in parts))

    def _register(self, observations: np.ndarray) -> Registered:
        features = self.features.apply(observations).numpy()
        return self.registration.register(features, observations if self.pixels is None else grey(observations))

    @property
    def pixels(self) -> KnownPixels | None:
        """The training images' pixels; None: they are not compared, and no yaw is found."""
        return self.registration.pixels

    def list_arrays(self) -> dict[str, np.ndarray]:
        """What is stored of the training images, by name."""
        known = self.registration
        arrays = {name: getattr(known, name) for name in ARRAYS}
        return arrays if known.pixels is None else arrays | {"images": known.pixels.images, "noise": known.pixels.noise}

    def list_numbers(self) -> dict[str, Any]:
        """What JSON holds of the registration."""
        known = self.registration
        return {
            "kernel": list(known.kernel),
            "calibration": asdict(known.calibration),
            "chirality": known.chirality,
            "heading": None if known.pixels is None else known.pixels.heading,
        }

    def pack(self) -> Packed:
        """All as tensors and as what JSON holds."""
        tensors = {name: torch.from_numpy(array) for name, array in self.list_arrays().items()}
        return Packed(tensors, self.list_numbers()).add("features", pack_features(self.features))

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        """The map that was packed; raises KeyError where a part is missing."""
        arrays, numbers = {name: tensor.numpy() for name, tensor in packed.tensors.items()}, packed.numbers
        pixels = None
        if numbers["heading"] is not None:
            pixels = KnownPixels(arrays["images"], arrays["noise"], float(numbers["heading"]))
        registration = Registration(
            **{name: arrays[name] for name in ARRAYS},
            kernel=Kernel(*numbers["kernel"]),
            calibration=TypeAdapter(Calibration).validate_python(numbers["calibration"]),
            pixels=pixels,
            chirality=int(numbers["chirality"]),
        )
        return cls(unpack_features(packed.take("features")), registration)
