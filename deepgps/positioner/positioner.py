"""Trained methods as maps from observations to positions."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from deepgps.config.learning import LearnSettings, NetworkSettings
from deepgps.config.methods import find_method
from deepgps.data.features import Features, check_shape
from deepgps.learning.batches import Inputs
from deepgps.learning.training_data import TrainingData
from deepgps.positioner.confidence import COMPONENTS, Confidence
from deepgps.positioner.headings import HeadingTable, Yaws
from deepgps.positioner.nearest_scan import ScanPositioner
from deepgps.positioner.trilateration import LandmarkPositioner
from sim.errors import WorkError
from sim.sensors.camera.mount import Upright

CHUNK = 500
CPU = torch.device("cpu")
LARGEST_TABLE = 16_000_000
"""Maximum number of distances between observations and stored neighbours that are in memory at once."""


@dataclass(frozen=True)
class NetworkPositioner:
    """Positions by a trained network.

    Attributes:
        shape: Shape of one observation.
        features: The map from observations to the network's input; none: the network takes images.
        settings: Settings of the network.
        network: The trained network, in evaluation mode, on any device; all else is on the CPU.
        centre: Origin of the plane in the network's output space (D,) [m].
        axes: Axes of the plane (D, 2).
        upright: Sets images of a leaning camera upright before all else; None: images are taken as they are.
        headings: Table from which yaw is found; none: it gives positions alone.
        mount: Camera ahead of the axle and to its left [m]. Positions are the axle's if a yaw is found and this is not
            zero, else the camera's.
        confidence: Table from which novelty and radii are found; none: positions are given without.
        likeness: The map from observations to the features that this table compares, of a network that takes images.
    """

    shape: tuple[int, ...]
    features: Features | None
    settings: NetworkSettings
    network: nn.Module
    centre: torch.Tensor
    axes: torch.Tensor
    upright: Upright | None = None
    headings: HeadingTable | None = None
    mount: tuple[float, float] = (0.0, 0.0)
    confidence: Confidence | None = None
    likeness: Features | None = None

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Positions (B, 2) float64 [m], in the method's own frame, of observations (B, ...)."""
        camera = self.locate_camera(observations)
        if self.headings is None or not any(self.mount):
            return camera
        chunks = [slice(start, start + CHUNK) for start in range(0, len(camera), CHUNK)]
        yaws = [self.find_yaws(observations[chunk], camera[chunk]).yaw[:, 0] for chunk in chunks]
        return self.leave_camera(camera, np.concatenate([np.empty(0), *yaws]))

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        """Positions of the camera (B, 2) float64 [m]."""
        return self.embed(observations) @ self.axes.double().numpy()

    def locate_with_features(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the camera (B, 2) float64 [m], and the features (B, at most COMPONENTS) that are compared."""
        check_shape(observations, self.shape)
        projection = self.likeness if self.features is None else self.features
        assert projection is not None
        compared = min(COMPONENTS, projection.basis.shape[1])  # no more are kept: of a million images, all are 1 GB
        features = np.empty((len(observations), compared), np.float32)
        found = np.empty((len(observations), len(self.centre)))
        for start in range(0, len(observations), CHUNK):
            part = slice(start, start + CHUNK)
            images = self._set_upright(observations[part])
            described = projection.apply(images)
            features[part] = described[:, :compared]
            found[part] = self._run(torch.from_numpy(images.copy()) if self.features is None else described)
        return found @ self.axes.double().numpy(), features

    def find_yaws(self, observations: np.ndarray, camera: np.ndarray) -> Yaws:
        """Yaws of the robot at positions of the camera (B, 2) [m]; only with a table of headings."""
        assert self.headings is not None
        return self.headings.find(self._set_upright(observations), camera)

    def leave_camera(self, camera: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Positions of the axle (B, 2) [m] by those of the camera and the yaw (B,) [rad]; where it is NaN, the same."""
        assert self.headings is not None
        ahead, left = self.mount
        left *= self.headings.chirality
        cos, sin = np.cos(yaw), np.sin(yaw)
        return camera - np.nan_to_num(np.stack([cos * ahead - sin * left, sin * ahead + cos * left], axis=1))

    def embed(self, observations: np.ndarray) -> np.ndarray:
        """Outputs of the network (B, D) float64 [m], relative to ``centre``, before projection onto the plane."""
        check_shape(observations, self.shape)
        found = np.empty((len(observations), len(self.centre)))
        for start in range(0, len(observations), CHUNK):
            images = self._set_upright(observations[start : start + CHUNK])
            table = self.features.apply(images) if self.features else torch.from_numpy(images.copy())
            found[start : start + CHUNK] = self._run(table)
        return found

    def _set_upright(self, observations: np.ndarray) -> np.ndarray:
        images = np.asarray(observations)
        return images if self.upright is None else self.upright(images)

    def _run(self, table: torch.Tensor) -> np.ndarray:
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            return (self.network(Inputs(table.to(device)).take(slice(None))).cpu() - self.centre).numpy()


@dataclass(frozen=True)
class NeighbourPositioner:
    """Positions by the nearest training observations in feature space, averaged with weights 1 / distance squared.

    Attributes:
        features: The map from observations to features.
        known: Features of the training observations (N, components).
        places: Their positions (N, 2) float64 [m].
        neighbours: Number of neighbours that are averaged.
        headings: Table from which yaw is found; none: it gives positions alone.
        confidence: Table from which novelty and radii are found; none: positions are given without.
    """

    features: Features
    known: torch.Tensor
    places: torch.Tensor
    neighbours: int
    headings: HeadingTable | None = None
    confidence: Confidence | None = None

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Positions (B, 2) float64 [m] of observations (B, ...)."""
        return self.locate_with_features(observations)[0]

    def locate_with_features(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (B, 2) float64 [m] of observations (B, ...), and their features (B, components)."""
        features = self.features.apply(observations)
        chunk = max(1, min(CHUNK, LARGEST_TABLE // max(1, len(self.known))))
        found = [self._position(part) for part in features.split(chunk)]
        return np.concatenate([np.zeros((0, 2)), *found]), features.numpy()

    def _position(self, features: torch.Tensor) -> np.ndarray:
        nearest = torch.cdist(features, self.known).topk(min(self.neighbours, len(self.known)), largest=False)
        weight = nearest.values.double().square().clamp_min(1e-12).reciprocal()
        weight = weight / weight.sum(dim=1, keepdim=True)
        return (weight[..., None] * self.places[nearest.indices]).sum(dim=1).numpy()


@dataclass(frozen=True)
class ArrayPositioner:
    """Positions by a plugin's method from the arrays that it has learned.

    Attributes:
        method: Name of the method, whose plugin must be loaded.
        arrays: What it has learned, by name.
    """

    method: str
    arrays: Mapping[str, np.ndarray]

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Positions (B, 2) float64 [m], in the method's own frame, of observations (B, ...)."""
        method = find_method(self.method)
        assert method.predict is not None
        found = np.asarray(method.predict(self.arrays, np.asarray(observations)), float)
        if found.shape != (len(observations), 2):
            raise WorkError(f"method {self.method}: predict must return {(len(observations), 2)}, not {found.shape}")
        return found


FeaturePositioner = NetworkPositioner | NeighbourPositioner
"""Those that compare features of observations, and so may know yaw, novelty and radii."""
Positioner = FeaturePositioner | LandmarkPositioner | ScanPositioner | ArrayPositioner


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


def headings_of(positioner: Positioner) -> HeadingTable | None:
    """The table from which a positioner finds yaw; None: it gives positions alone."""
    return positioner.headings if isinstance(positioner, FeaturePositioner) else None


def confidence_of(positioner: Positioner) -> Confidence | None:
    """The table from which a positioner finds novelty and radii; None: it gives positions without."""
    return positioner.confidence if isinstance(positioner, FeaturePositioner) else None


def as_positioner(
    data: TrainingData, settings: LearnSettings, network: nn.Module, centre: torch.Tensor, axes: torch.Tensor
) -> NetworkPositioner:
    """The trained network as a positioner, on the device where it was trained."""
    projection, features, likeness = data.projection, None, None
    if settings.network.architecture == "spectral":
        features = projection
    else:
        likeness = replace(projection, basis=projection.basis[:, :COMPONENTS].contiguous())
    return NetworkPositioner(
        data.shape,
        features,
        settings.network,
        network.eval(),
        centre.cpu(),
        axes.cpu(),
        data.upright,
        likeness=likeness,
    )
