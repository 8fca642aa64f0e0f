"""Training one method: on readings that can be, and with the same result to the byte on any number of cores."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.config.methods import METHODS
from deepgps.data.checks import check_observations, check_recording
from deepgps.data.segments import fill_stretches, read_segments
from deepgps.initial_map.stored_map import StoredMap, read_map
from deepgps.learning.trainer import describe_device, use_threads
from deepgps.methods.deepgps import remove_leftovers
from deepgps.positioner.confidence_fit import make_confidence
from deepgps.positioner.heading_fit import make_headings
from deepgps.positioner.positioner import FeaturePositioner, Fitted, Positioner
from deepgps.positioner.registration import RegistrationPositioner
from deepgps.positioner.stored_positioner import is_finished, load_positioner, save_positioner
from deepgps.positioner.without_features import ArrayPositioner
from deepgps.terminal.progress import Report, ignore
from sim.errors import WorkError
from sim.recording.format import Recording, observation_file


def fit_method(
    name: str, recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train a method of this name into ``folder``; a finished training is loaded, and an interrupted one continues.

    Raises:
        InputError: The method cannot learn from these readings or observations.
    """
    method = METHODS[name]
    fit = resolve_name(method.fit) if isinstance(method.fit, str) else method.fit
    with use_threads(settings.train.threads):
        if not is_finished(folder):
            check_recording(recording)
            check_observations(recording.observation, observation_file(recording.manifest.sensor))
            start = time.perf_counter()
            fitted = fit(recording, settings, seed, folder, progress)
            if not isinstance(fitted, Fitted):
                raise WorkError(f"method {name}: fit must return deepgps.Fitted, not a {type(fitted).__name__}")
            positioner, training = fitted
            if method.predict is not None and isinstance(positioner, Mapping):
                parameters = sum(np.asarray(array).size for array in positioner.values())
                took = {"steps": 0, "train_s": round(time.perf_counter() - start, 1), "parameters": parameters}
                positioner, training = ArrayPositioner(name, positioner), {**took, **training}
            positioner = learn_headings(positioner, recording, folder)
            mapped = None if training.get("attempt") else read_map(folder)  # restarts do not begin with this map
            undecided = fill_stretches(training.get("map", {}).get("parts", []), len(recording.observation))
            positioner = learn_confidence(positioner, recording, mapped, undecided, method.reads_ticks)
            device = describe_device(settings.train.device, settings.train.bfloat16)
            made = {"trained_on": device} if method.in_steps else {}
            save_positioner(folder, positioner, {**training, **made})
        remove_leftovers(folder)
        return load_positioner(folder)


def learn_headings(positioner: Any, recording: Recording, folder: Path) -> Any:
    """The positioner with a table of headings from its own map, if it takes polar images."""
    if recording.kind != "polar_image" or not _needs_tables(positioner):
        return positioner
    positions = positioner(recording.observation)  # the camera's, since there is no yaw yet
    if positioner.upright is not None:
        recording = replace(recording, observation=positioner.upright.copy(recording.observation, folder))
    headings = make_headings(recording, positions)
    return positioner if headings is None else replace(positioner, headings=headings)


def learn_confidence(
    positioner: Any, recording: Recording, mapped: StoredMap | None, undecided: np.ndarray, reads_ticks: bool
) -> Any:
    """The positioner with a table of confidence from its own map, if there are features of its observations.

    ``mapped`` is the map from which its training started, if that is known with its errors, ``undecided`` (N,) bool the
    observations that may lie elsewhere on its map, and ``reads_ticks`` whether it learned from the encoders.
    """
    if not _needs_tables(positioner):
        return positioner
    segments, (camera, features) = read_segments(recording), positioner.locate_with_features(recording.observation)
    if not reads_ticks:  # images are evenly spaced
        segments = replace(segments, distance=torch.arange(segments.index.shape[1]).expand(segments.index.shape))
    map_std = None if mapped is None else mapped.expected / np.sqrt(2.0)
    table = make_confidence(segments, features, camera, map_std, undecided)
    return positioner if table is None else replace(positioner, confidence=table)


def _needs_tables(positioner: Any) -> bool:
    return isinstance(positioner, FeaturePositioner) and not isinstance(positioner, RegistrationPositioner)
