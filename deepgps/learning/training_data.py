"""The data that every method learns from: a recording's segments, its features, and the network's input."""

import hashlib
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from deepgps.config.learning import FeatureSettings, LearnSettings
from deepgps.data.features import Features, fit_features, normalise
from deepgps.data.segments import Segments, read_segments
from deepgps.learning.batches import Inputs
from deepgps.learning.networks import make_network
from deepgps.learning.trainer import choose_device, make_generator, use_threads
from deepgps.terminal.progress import Report, ignore
from sim.errors import DamagedError
from sim.files.atomic import only_process, write_atomic
from sim.files.checksums import check_sha256, read_json, sha256, write_json
from sim.recording.format import Recording, observation_file
from sim.sensors.camera.mount import Upright

log = logging.getLogger(__name__)
FEATURES, TABLE, KEY = "features", "features.safetensors", "features.key"
"""The run's folder of features, which all its methods share, and its files."""


@dataclass(frozen=True)
class TrainingData:
    """A recording prepared for learning."""

    segments: Segments  # Weak constraints
    projection: Features  # The map from observations to features
    features: torch.Tensor  # Features of the training observations (N, components)
    inputs: Inputs  # The network's input, on the device
    observation: np.ndarray  # The training observations (N, ...), set upright if the camera leans
    upright: Upright | None = None  # Sets images of a leaning camera upright; None: the method takes images as they are

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation."""
        return tuple(self.observation.shape[1:])

    @property
    def device(self) -> torch.device:
        """The device on which the network is trained."""
        return self.inputs.table.device


def prepare(
    recording: Recording,
    settings: LearnSettings,
    seed: int,
    folder: Path,
    upright: Upright | None = None,
    progress: Report = ignore,
) -> TrainingData:
    """Read the segments, and compute the features or load those that another method has left in ``folder``.

    Images and scans become slow spectral features; vectors, such as distances to landmarks, are only normalised. Images
    that are set upright first have features of their own, which no other method shares.
    """
    segments, leaning = read_segments(recording), upright is not None and any(upright.lean)
    if upright is not None and leaning:
        recording = replace(recording, observation=upright.copy(recording.observation, folder))
    if recording.kind == "vector":
        projection, features = normalise(recording.observation)
    else:
        progress("features", 0, 1)
        generator = make_generator(seed, "features")
        with use_threads(settings.train.threads):
            if leaning:
                projection, features = fit_features(recording.observation, segments, settings.features, generator)
            else:
                key = digest_features(recording, settings, seed)
                projection, features = cached_features(
                    folder / FEATURES, key, recording.observation, segments, settings.features, generator
                )
        progress("features", 1, 1)
    table = add_headings(projection, features, recording)
    if settings.network.architecture != "spectral":
        table = torch.from_numpy(recording.observation)  # stays on disk until it is drawn
    inputs = Inputs(table.to(choose_device(settings.train.device)), settings.features.noise, settings.train.shift)
    return TrainingData(segments, projection, features, inputs, recording.observation, upright)


def cached_features(
    folder: Path,
    key: str,
    observation: np.ndarray,
    segments: Segments,
    settings: FeatureSettings,
    generator: torch.Generator,
) -> tuple[Features, torch.Tensor]:
    """Like ``fit_features``, but read from a folder if it holds intact features with the same ``key``.

    Another process that computes them there is waited for.
    """
    with only_process(folder):
        found = _read_features(folder, key)
        if found is None:
            (folder / KEY).unlink(missing_ok=True)
            fitted, features = fit_features(observation, segments, settings, generator)
            made = {"mean": fitted.mean, "basis": fitted.basis.contiguous(), "features": features.contiguous()}
            if fitted.edges is not None:
                made["edges"] = fitted.edges
            write_atomic(folder / TABLE, lambda part: save_file(made, part), features.nbytes)
            write_json(folder / KEY, {"key": key, "sha256": sha256(folder / TABLE)})
            found = load_file(folder / TABLE)  # which leaves them on the disk: those of a million images are 1 GB
    shape = tuple(observation.shape[1:])
    mean, basis = found["mean"], found["basis"]
    fitted = Features(shape, settings.frequencies, mean, basis, found.get("edges"), settings.values)
    return fitted, found["features"]


def _read_features(folder: Path, key: str) -> dict[str, torch.Tensor] | None:
    """Features stored in a folder with this key; None if the key differs or they are damaged."""
    if not ((folder / KEY).is_file() and (folder / TABLE).is_file()):  # the key is written last
        return None
    try:
        stored = read_json(folder / KEY)
        check_sha256(folder / TABLE, str(stored.get("sha256")))
        return load_file(folder / TABLE) if stored.get("key") == key else None
    except (DamagedError, SafetensorError) as error:
        log.warning("%s; the features are made again", error)
        return None


def digest_features(recording: Recording, settings: LearnSettings, seed: int) -> str:
    """Hexadecimal digest of all that determines the features: settings, seed, images, and the order of the images.

    Ticks do not determine them, so runs that differ only in their ticks can share features.
    """
    sensor = recording.manifest.sensor
    images = recording.manifest.sha256.get(observation_file(sensor))
    # if the manifest holds no checksum, the ticks distinguish recordings
    order = recording.reading[:, :2] if images else recording.reading
    made_by = f"{settings.features} {settings.train.threads} {seed} {images}"
    return hashlib.sha256(made_by.encode() + np.asarray(order).tobytes()).hexdigest()


def add_headings(projection: Features, features: torch.Tensor, recording: Recording) -> torch.Tensor:
    """Features (N, headings, components) of scans at every heading kept; with one heading, the features as given."""
    observation = recording.observation
    if recording.kind != "scan" or observation.shape[1] == 1:
        return features
    others = [projection.apply(observation, heading) for heading in range(1, observation.shape[1])]
    return torch.stack([features, *others], dim=1)


def new_network(data: TrainingData, settings: LearnSettings, outputs: int, seed: int, attempt: int = 0) -> nn.Module:
    """Create a network for this data, with weights drawn for this seed and attempt."""
    generator = make_generator(seed, "weights", attempt)
    return make_network(settings.network, data.features.shape[1], outputs, generator)
