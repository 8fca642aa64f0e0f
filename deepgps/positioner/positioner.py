"""Trained methods as maps from observations to positions: by a network, or by the nearest training observations.

Each packs itself into tensors and what JSON holds, from which ``unpack`` makes it again; ``stored_positioner`` writes
and reads both.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import torch
from pydantic import TypeAdapter
from scipy.spatial import KDTree
from torch import nn

from deepgps.config.learning import LearnSettings, NetworkSettings
from deepgps.data.features import Features, check_shape
from deepgps.learning.batches import Inputs
from deepgps.learning.networks import make_network
from deepgps.learning.training_data import TrainingData
from deepgps.positioner.appearance import AppearanceMap, Packed, pack_features, unpack_features
from deepgps.positioner.registration import Registered, Registration, subtract_mount
from sim.sensors.camera.mount import Upright

CHUNK = 500
CPU = torch.device("cpu")
MAX_TABLE_DISTANCES = 16_000_000
"""Maximum number of distances between observations and stored neighbours that are in memory at once."""


class Positioner(ABC):
    """A trained method as a map from observations to positions."""

    kind: ClassVar[str]  # Name of the class in ``positioner.json``

    @property
    def mirrored(self) -> bool | None:
        """Whether a turn to the left is one to the right on its map; None: it is not known."""
        return None

    @property
    def mapped(self) -> KDTree | None:
        """Places on its map of the images that it compares others with [m]; None: it is not known."""
        return None

    @abstractmethod
    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Positions (B, 2) float64 [m], in the method's own frame, of observations (B, ...)."""

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        """Positions of the camera (B, 2) float64 [m]."""
        return self(observations)

    def locate_training(self, observations: np.ndarray) -> np.ndarray:
        """Positions (N, 2) float64 [m] of all training observations (N, ...)."""
        return self(observations)

    @abstractmethod
    def pack(self) -> Packed:
        """All that is its own as tensors and as what JSON holds."""

    @classmethod
    @abstractmethod
    def unpack(cls, packed: Packed) -> Self:
        """The positioner that was packed; raises KeyError where a part is missing."""


@dataclass(frozen=True, kw_only=True)
class FeaturePositioner(Positioner):
    """One that compares features of observations, and so may know its errors and the yaw by registration."""

    # Sets images of a leaning camera upright before all else; None: images are taken as they are
    upright: Upright | None = None
    # What is seen where on the method's own map; None: it gives positions alone
    appearance: AppearanceMap | None = None
    # Camera ahead of the axle and to its left [m]. Positions are the axle's if a yaw is found, else the camera's
    mount: tuple[float, float] = (0.0, 0.0)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        camera = self.locate_camera(observations)
        if self.appearance is None or not any(self.mount):
            return camera
        return self.leave_camera(camera, self.appearance.register(self.set_upright(observations)).yaw)

    @abstractmethod
    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        """Positions of the camera (B, 2) float64 [m]."""

    def register(self, observations: np.ndarray) -> Registered | None:
        """What registration says of the camera's positions for observations (B, ...); None where it knows nothing."""
        if self.appearance is None:
            return None
        found, usual = (
            self.appearance.register(self.set_upright(observations)),
            self.appearance.registration.calibration,
        )
        return found.move(self.locate_camera(observations), usual.difference)

    @property
    def mirrored(self) -> bool | None:
        if self.appearance is None or self.appearance.pixels is None:
            return None
        return self.appearance.registration.chirality < 0

    @property
    def mapped(self) -> KDTree | None:
        return None if self.appearance is None else self.appearance.registration.tree

    def leave_camera(self, camera: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Positions of the axle (B, 2) [m] by those of the camera and the yaw (B,) [rad]; where it is NaN, the same."""
        return subtract_mount(camera, yaw, self.mount, bool(self.mirrored))

    def set_upright(self, observations: np.ndarray) -> np.ndarray:
        """Images as if the camera had not leaned."""
        images = np.asarray(observations)
        return images if self.upright is None else self.upright(images)

    def pack_shared(self) -> Packed:
        """What all that compare features have, as tensors and as what JSON holds."""
        numbers: dict[str, Any] = {"mount_m": list(self.mount)}
        if self.upright is not None:
            numbers["upright"] = asdict(self.upright)
        packed = Packed({}, numbers)
        return packed if self.appearance is None else packed.add("appearance", self.appearance.pack())

    def unpack_shared(self, packed: Packed) -> Self:
        """The same with what was packed so; raises KeyError where a part is missing."""
        ahead, left = packed.numbers["mount_m"]
        upright = TypeAdapter(Upright | None).validate_python(packed.numbers.get("upright"))
        known = AppearanceMap.unpack(packed.take("appearance")) if "appearance" in packed.numbers else None
        return replace(self, upright=upright, mount=(float(ahead), float(left)), appearance=known)


@dataclass(frozen=True)
class NetworkPositioner(FeaturePositioner):
    """Positions by a trained network."""

    kind = "network"

    shape: tuple[int, ...]  # Shape of one observation
    features: Features | None  # The map from observations to the network's input; none: the network takes images
    settings: NetworkSettings  # Settings of the network
    network: nn.Module  # The trained network, in evaluation mode, on any device; all else is on the CPU
    centre: torch.Tensor  # Origin of the plane in the network's output space (D,) [m]
    axes: torch.Tensor  # Axes of the plane (D, 2)

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        return self.embed(observations) @ self.axes.double().numpy()

    def embed(self, observations: np.ndarray) -> np.ndarray:
        """Outputs of the network (B, D) float64 [m], relative to ``centre``, before projection onto the plane."""
        check_shape(observations, self.shape)
        found = np.empty((len(observations), len(self.centre)))
        for start in range(0, len(observations), CHUNK):
            images = self.set_upright(observations[start : start + CHUNK])
            table = self.features.apply(images) if self.features else torch.from_numpy(images.copy())
            found[start : start + CHUNK] = self._run(table)
        return found

    def pack(self) -> Packed:
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        tensors |= {"centre": self.centre, "axes": self.axes}
        numbers = {"network": self.settings.model_dump(mode="json"), "shape": list(self.shape)}
        packed = Packed(tensors, numbers)
        return packed if self.features is None else packed.add("features", pack_features(self.features))

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        tensors, numbers = packed
        features = unpack_features(packed.take("features")) if "features" in numbers else None
        settings = NetworkSettings.model_validate(numbers["network"])
        inputs = 0 if features is None else features.basis.shape[1]
        network = make_network(settings, inputs, len(tensors["centre"]), torch.Generator())
        own = {name.removeprefix("network."): t for name, t in tensors.items() if name.startswith("network.")}
        network.load_state_dict(own)
        return cls(tuple(numbers["shape"]), features, settings, network.eval(), tensors["centre"], tensors["axes"])

    def _run(self, table: torch.Tensor) -> np.ndarray:
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            return (self.network(Inputs(table.to(device)).take(slice(None))).cpu() - self.centre).numpy()


@dataclass(frozen=True)
class NeighbourPositioner(FeaturePositioner):
    """Positions by the nearest training observations in feature space, averaged with weights 1 / distance squared."""

    kind = "neighbours"

    features: Features  # The map from observations to features
    known: torch.Tensor  # Features of the training observations (N, components)
    places: torch.Tensor  # Their positions (N, 2) float64 [m]
    neighbours: int  # Number of neighbours that are averaged

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        features = self.features.apply(observations)
        chunk = max(1, min(CHUNK, MAX_TABLE_DISTANCES // max(1, len(self.known))))
        return np.concatenate([np.zeros((0, 2)), *(self._position(part) for part in features.split(chunk))])

    def pack(self) -> Packed:
        packed = Packed({"known": self.known, "places": self.places}, {"neighbours": self.neighbours})
        return packed.add("features", pack_features(self.features))

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        tensors, numbers = packed
        features = unpack_features(packed.take("features"))
        return cls(features, tensors["known"], tensors["places"], numbers["neighbours"])

    def _position(self, features: torch.Tensor) -> np.ndarray:
        nearest = torch.cdist(features, self.known).topk(min(self.neighbours, len(self.known)), largest=False)
        weight = nearest.values.double().square().clamp_min(1e-12).reciprocal()
        weight = weight / weight.sum(dim=1, keepdim=True)
        return (weight[..., None] * self.places[nearest.indices]).sum(dim=1).numpy()


@dataclass(frozen=True)
class LinearPositioner(FeaturePositioner):
    """Positions as a linear map of features and of products of the slowest."""

    kind = "linear"

    features: Features  # The map from observations to features
    weights: torch.Tensor  # Of each feature, then of each product (D, 2) float64 [m]

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        features = self.features.apply(observations).numpy()
        multiplied = int((2 * (len(self.weights) - features.shape[1])) ** 0.5)  # n features have n (n + 1) / 2 products
        starts, weights = range(0, len(features), CHUNK), self.weights.numpy()
        parts = (multiply_slowest(features[start : start + CHUNK].astype(float), multiplied) for start in starts)
        return np.concatenate([np.zeros((0, 2)), *(part @ weights for part in parts)])

    def pack(self) -> Packed:
        return Packed({"weights": self.weights}, {}).add("features", pack_features(self.features))

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        return cls(unpack_features(packed.take("features")), packed.tensors["weights"])


def multiply_slowest(features: np.ndarray, count: int) -> np.ndarray:
    """Features (..., K) and the products of the first ``count``, beginning with those of the first alone (..., D)."""
    one, other = np.tril_indices(count)
    return np.concatenate([features, features[..., one] * features[..., other]], axis=-1)


@dataclass(frozen=True)
class RegistrationPositioner(FeaturePositioner):
    """Positions by registration alone."""

    kind = "registration"

    index: np.ndarray  # Numbers of the images on the map among all training observations (n,)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        found = self.register(observations)
        return self.leave_camera(found.position, found.yaw)

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        return self.register(observations).position

    def register(self, observations: np.ndarray) -> Registered:
        assert self.appearance is not None
        return self.appearance.register(self.set_upright(observations))

    @property
    def known(self) -> Registration:
        """The training images on the map."""
        assert self.appearance is not None
        return self.appearance.registration

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation."""
        assert self.appearance is not None
        return self.appearance.features.shape

    def locate_training(self, observations: np.ndarray) -> np.ndarray:
        if any(self.mount):
            return self(observations)
        others = np.setdiff1d(np.arange(len(observations)), self.index)
        places = np.empty((len(observations), 2))
        places[self.index], places[others] = self.known.places, self(observations[others])
        return places

    def pack(self) -> Packed:
        return Packed({"index": torch.from_numpy(self.index)}, {})

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        return cls(packed.tensors["index"].numpy())


class Fitted(NamedTuple):
    """A trained method.

    Attributes:
        positioner: The learned map from observations to positions; or, of a plugin's method with ``predict``, arrays by
            name.
        training: The record of the training, for ``training.json``: ``steps``, ``train_s``, ``parameters`` and others;
            what a method with ``predict`` leaves out is filled in.
    """

    positioner: Positioner | Mapping[str, np.ndarray]
    training: Mapping[str, Any] = MappingProxyType({})

    def note(self, more: Mapping[str, Any]) -> "Fitted":
        """The same with more entries in the record of the training."""
        return self._replace(training={**self.training, **more})


def as_positioner(
    data: TrainingData, settings: LearnSettings, network: nn.Module, centre: torch.Tensor, axes: torch.Tensor
) -> NetworkPositioner:
    """The trained network as a positioner, on the device where it was trained."""
    features = data.projection if settings.network.architecture == "spectral" else None
    plane = (centre.cpu(), axes.cpu())
    return NetworkPositioner(data.shape, features, settings.network, network.eval(), *plane, upright=data.upright)
