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
from torch import nn

from deepgps.config.learning import FeatureSettings, LearnSettings, NetworkSettings
from deepgps.data.features import Features, check_shape
from deepgps.learning.batches import Inputs
from deepgps.learning.networks import make_network
from deepgps.learning.training_data import TrainingData
from deepgps.positioner.confidence import COMPONENTS, Confidence
from deepgps.positioner.headings import HeadingTable, Yaws
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.mount import Upright

CHUNK = 500
CPU = torch.device("cpu")
MAX_TABLE_DISTANCES = 16_000_000
"""Maximum number of distances between observations and stored neighbours that are in memory at once."""


class Packed(NamedTuple):
    """Tensors by name, and what JSON holds, of which a positioner is made again."""

    tensors: dict[str, torch.Tensor]
    numbers: dict[str, Any]


class Positioner(ABC):
    """A trained method as a map from observations to positions."""

    kind: ClassVar[str]  # Name of the class in ``positioner.json``
    headings: HeadingTable | None = None  # Table from which yaw is found; None: it gives positions alone
    # Table from which novelty and radii are found; None: positions are given without
    confidence: Confidence | None = None

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
        """All but the two tables as tensors and as what JSON holds."""

    @classmethod
    @abstractmethod
    def unpack(cls, packed: Packed) -> Self:
        """The positioner that was packed; raises KeyError where a part is missing."""


@dataclass(frozen=True, kw_only=True)
class FeaturePositioner(Positioner):
    """One that compares features of observations, and so may know yaw, novelty and radii."""

    headings: HeadingTable | None = None
    confidence: Confidence | None = None
    # Sets images of a leaning camera upright before all else; None: images are taken as they are
    upright: Upright | None = None

    @abstractmethod
    def locate_with_features(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the camera (B, 2) float64 [m], and the features (B, K) that are compared."""

    def find_yaws(self, observations: np.ndarray, camera: np.ndarray) -> Yaws:
        """Yaws of the robot at positions of the camera (B, 2) [m]; only with a table of headings."""
        assert self.headings is not None
        return self.headings.find(self.set_upright(observations), camera)

    def leave_camera(self, camera: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Positions of the axle (B, 2) [m] by those of the camera and the yaw (B,) [rad]; where it is NaN, the same."""
        return camera

    def set_upright(self, observations: np.ndarray) -> np.ndarray:
        """Images as if the camera had not leaned."""
        images = np.asarray(observations)
        return images if self.upright is None else self.upright(images)


def subtract_mount(camera: np.ndarray, yaw: np.ndarray, mount: tuple[float, float], chirality: int) -> np.ndarray:
    """Positions of the axle by those of the camera (B, 2) [m] and the yaw (B,) [rad]; where it is NaN, the same."""
    ahead, left = mount[0], chirality * mount[1]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return camera - np.nan_to_num(np.stack([cos * ahead - sin * left, sin * ahead + cos * left], axis=1))


def pack_features(features: Features) -> Packed:
    """The map to features, without the shape of an observation."""
    tensors = {"features.mean": features.mean, "features.basis": features.basis}
    if features.edges is not None:
        tensors["features.edges"] = features.edges
    return Packed(tensors, {"frequencies": features.frequencies, "values": features.values})


def unpack_features(packed: Packed, name: str = "features") -> Features:
    """The map to features whose tensors have this name, with the shape of an observation among the numbers."""
    tensors, numbers = packed
    mean, basis, edges = tensors[f"{name}.mean"], tensors[f"{name}.basis"], tensors.get(f"{name}.edges")
    values = FeatureSettings(values=numbers["values"]).values
    return Features(tuple(numbers["shape"]), numbers["frequencies"], mean, basis, edges, values)


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
    # Camera ahead of the axle and to its left [m]. Positions are the axle's if a yaw is found and this is not zero,
    # else the camera's
    mount: tuple[float, float] = (0.0, 0.0)
    # The map from observations to the features that are compared, of a network that takes images
    likeness: Features | None = None

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        camera = self.locate_camera(observations)
        if self.headings is None or not any(self.mount):
            return camera
        chunks = [slice(start, start + CHUNK) for start in range(0, len(camera), CHUNK)]
        yaws = [self.find_yaws(observations[chunk], camera[chunk]).yaw[:, 0] for chunk in chunks]
        return self.leave_camera(camera, np.concatenate([np.empty(0), *yaws]))

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        return self.embed(observations) @ self.axes.double().numpy()

    def locate_with_features(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        check_shape(observations, self.shape)
        projection = self.likeness if self.features is None else self.features
        assert projection is not None
        compared = min(COMPONENTS, projection.basis.shape[1])  # no more are kept: of a million images, all are 1 GB
        features = np.empty((len(observations), compared), np.float32)
        found = np.empty((len(observations), len(self.centre)))
        for start in range(0, len(observations), CHUNK):
            part = slice(start, start + CHUNK)
            images = self.set_upright(observations[part])
            described = projection.apply(images)
            features[part] = described[:, :compared]
            found[part] = self._run(torch.from_numpy(images.copy()) if self.features is None else described)
        return found @ self.axes.double().numpy(), features

    def leave_camera(self, camera: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        assert self.headings is not None
        return subtract_mount(camera, yaw, self.mount, self.headings.chirality)

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
        if self.upright is not None:
            numbers["upright"] = asdict(self.upright)
        if self.likeness is not None:
            tensors |= {"likeness.mean": self.likeness.mean, "likeness.basis": self.likeness.basis}
            numbers["likeness"] = {"frequencies": self.likeness.frequencies, "values": self.likeness.values}
        if any(self.mount):
            numbers["mount_m"] = list(self.mount)
        stored, how = Packed({}, {"frequencies": None}) if self.features is None else pack_features(self.features)
        return Packed(tensors | stored, numbers | how)

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        tensors, numbers = packed
        features = None if numbers["frequencies"] is None else unpack_features(packed)
        likeness = numbers.get("likeness")
        settings = NetworkSettings.model_validate(numbers["network"])
        inputs = 0 if features is None else features.basis.shape[1]
        network = make_network(settings, inputs, len(tensors["centre"]), torch.Generator())
        own = {name.removeprefix("network."): t for name, t in tensors.items() if name.startswith("network.")}
        network.load_state_dict(own)
        ahead, left = numbers.get("mount_m", (0.0, 0.0))
        return cls(
            tuple(numbers["shape"]),
            features,
            settings,
            network.eval(),
            tensors["centre"],
            tensors["axes"],
            upright=read_upright(numbers.get("upright")),
            mount=(float(ahead), float(left)),
            likeness=likeness and unpack_features(Packed(tensors, {**numbers, **likeness}), "likeness"),
        )

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

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        return self.locate_with_features(observations)[0]

    def locate_with_features(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        features = self.features.apply(observations)
        chunk = max(1, min(CHUNK, MAX_TABLE_DISTANCES // max(1, len(self.known))))
        found = [self._position(part) for part in features.split(chunk)]
        return np.concatenate([np.zeros((0, 2)), *found]), features.numpy()

    def pack(self) -> Packed:
        tensors, how = pack_features(self.features)
        numbers = {"neighbours": self.neighbours, "shape": list(self.features.shape)}
        return Packed(tensors | {"known": self.known, "places": self.places}, numbers | how)

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        tensors, numbers = packed
        features = unpack_features(packed)
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

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        return self.locate_with_features(observations)[0]

    def locate_with_features(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        features = self.features.apply(observations).numpy()
        multiplied = int((2 * (len(self.weights) - features.shape[1])) ** 0.5)  # n features have n (n + 1) / 2 products
        starts, weights = range(0, len(features), CHUNK), self.weights.numpy()
        parts = (multiply_slowest(features[start : start + CHUNK].astype(float), multiplied) for start in starts)
        return np.concatenate([np.zeros((0, 2)), *(part @ weights for part in parts)]), features

    def pack(self) -> Packed:
        tensors, how = pack_features(self.features)
        return Packed(tensors | {"weights": self.weights}, {"shape": list(self.features.shape)} | how)

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        return cls(unpack_features(packed), packed.tensors["weights"])


def multiply_slowest(features: np.ndarray, count: int) -> np.ndarray:
    """Features (..., K) and the products of the first ``count``, beginning with those of the first alone (..., D)."""
    one, other = np.tril_indices(count)
    return np.concatenate([features, features[..., one] * features[..., other]], axis=-1)


def read_upright(stored: Mapping[str, Any] | None) -> Upright | None:
    """What sets images upright, as a positioner packs it."""
    if stored is None:
        return None
    (roll, pitch), (right, ahead), (k1, k2, k3, k4) = stored["lean"], stored["parallax"], stored["lens"]["k"]
    return Upright(Lens(stored["lens"]["half_angle"], (k1, k2, k3, k4)), (roll, pitch), (right, ahead))


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
    features, likeness = data.projection, None
    if settings.network.architecture != "spectral":
        likeness = replace(features, basis=features.basis[:, :COMPONENTS].contiguous())
        features = None
    plane = (centre.cpu(), axes.cpu())
    return NetworkPositioner(
        data.shape, features, settings.network, network.eval(), *plane, upright=data.upright, likeness=likeness
    )
