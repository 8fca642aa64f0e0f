"""Training one method: on plausible readings alone, and with the same bytes on any number of cores."""

from importlib import import_module
from pathlib import Path

from deepgps.data.features import check_observations
from deepgps.data.plausible_readings import count_readings, keep_plausible
from deepgps.learning.trainer import use_threads
from deepgps.methods.attempts import remove_leftovers
from deepgps.methods.catalog import METHODS
from deepgps.methods.positioner import Positioner, is_finished, load_positioner, save_positioner
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from sim.recording.format import Recording, observation_file


def fit_method(
    name: str, recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train a method into ``folder``; a finished training is loaded, one that was stopped continues.

    Args:
        name: Of the method, as in ``METHODS``.
        recording: What it learns from.
        settings: How it learns.
        seed: Of weights and batches.
        folder: Where the method's files go.
        progress: Called with the steps done and their number.

    Raises:
        InputError: The readings or observations cannot be learned from.
    """
    module, _, function = METHODS[name].fit.partition(":")
    fit = getattr(import_module(module), function)
    with use_threads(settings.train.threads):
        if not is_finished(folder):
            recording = keep_plausible(recording)
            check_observations(recording.observation, observation_file(recording.manifest.sensor))
            positioner, training = fit(recording, settings, seed, folder, progress)
            save_positioner(folder, positioner, {**training, **count_readings(recording)})
        remove_leftovers(folder)
        return load_positioner(folder)
