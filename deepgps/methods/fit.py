"""Training one method: on readings that can be, and with the same result to the byte on any number of cores."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np

from deepgps.config.learning import LearnSettings
from deepgps.config.methods import METHODS
from deepgps.config.scenario import OBSERVATION_SOURCES
from deepgps.data.checks import check_observations, check_recording
from deepgps.data.segments import fill_stretches
from deepgps.initial_map.stored_map import read_map
from deepgps.learning.trainer import describe_device, use_threads
from deepgps.learning.training_data import prepare
from deepgps.methods.appearance import learn
from deepgps.methods.deepgps import remove_leftovers
from deepgps.methods.registration import MAX_LEFT_OUT_SHARE, find_headings
from deepgps.positioner.positioner import FeaturePositioner, Fitted, Positioner
from deepgps.positioner.stored_positioner import is_finished, load_positioner, save_positioner
from deepgps.positioner.without_features import ArrayPositioner
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError, WorkError
from sim.plugins import name_code
from sim.recording.format import Recording, observation_file


def fit_method(
    name: str, recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train a method of this name into ``folder``; a finished training is loaded, and an interrupted one continues.

    Raises InputError if the method cannot learn from these readings or observations.
    """
    method = METHODS[name]
    fit = resolve_name(method.fit) if isinstance(method.fit, str) else method.fit
    with use_threads(settings.train.threads):
        if not is_finished(folder):
            if method.observes not in (None, recording.kind):
                raise InputError(f"{recording.folder}: {name} needs {OBSERVATION_SOURCES[method.observes]}")
            check_recording(recording)
            check_observations(recording.observation, observation_file(recording.manifest.sensor))
            start = time.perf_counter()
            fitted = fit(recording, settings, seed, folder, progress)
            if not isinstance(fitted, Fitted):
                raise WorkError(f"{name_code(fit)} must return deepgps.Fitted, not a {type(fitted).__name__}")
            positioner, took = fitted.positioner, {"steps": 0, "train_s": round(time.perf_counter() - start, 1)}
            if method.predict is not None and isinstance(positioner, Mapping):
                took["parameters"] = sum(np.asarray(array).size for array in positioner.values())
                positioner = ArrayPositioner(name, positioner)
            training = {**took, **fitted.training}
            if isinstance(positioner, FeaturePositioner) and positioner.appearance is None:
                positioner = learn_appearance(positioner, training, recording, settings, seed, folder)
            device = describe_device(settings.train.device, settings.train.bfloat16)
            made = {"trained_on": device} if method.in_steps else {}
            save_positioner(folder, positioner, {**training, **made})
        remove_leftovers(folder)
        return load_positioner(folder)


def learn_appearance(
    positioner: FeaturePositioner,
    training: Mapping[str, Any],
    recording: Recording,
    settings: LearnSettings,
    seed: int,
    folder: Path,
) -> FeaturePositioner:
    """The positioner with what is seen where on its own map; the same where too few segments pass one another.

    Observations that may lie elsewhere are left out, so that those like them are refused, unless most may.
    """
    data = prepare(recording, settings, seed, folder.parent, positioner.upright)
    places = positioner.locate_camera(recording.observation)
    undecided = fill_stretches(training.get("map", {}).get("parts", []), len(places))
    if undecided.mean() <= MAX_LEFT_OUT_SHARE:
        places[undecided] = np.nan
    mapped = read_map(folder)
    std = None if mapped is None else np.nan_to_num(mapped.expected / np.sqrt(2.0))
    try:
        return replace(positioner, appearance=learn(data, places, find_headings(recording, places), std)[0])
    except InputError:
        return positioner
