"""The methods by name. Each learns only from readings that can be, and gives the same bytes on any number of cores."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path

from deepgps.data.features import check_observations
from deepgps.data.plausible_readings import keep_plausible
from deepgps.learning.trainer import use_threads
from deepgps.methods import deepgps, explicit, knn, odometry_labels, pca_knn, posenet
from deepgps.methods.positioner import Positioner, is_finished
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from sim.recording.format import Recording

Fit = Callable[[Recording, LearnSettings, int, Path, Report], Positioner]


def guard(fit: Fit) -> Fit:
    """The same method with its threads fixed, and what it learns from checked."""

    @wraps(fit)
    def fit_guarded(
        recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
    ) -> Positioner:
        with use_threads(settings.train.threads):
            if not is_finished(folder):
                recording = keep_plausible(recording)
                check_observations(recording.observation)
            return fit(recording, settings, seed, folder, progress)

    return fit_guarded


METHODS: dict[str, Fit] = {
    "deepgps": guard(deepgps.fit),
    "deepgps_aware": guard(deepgps.fit_aware),
    "deepgps_turns": guard(deepgps.fit_turns),
    "posenet": guard(posenet.fit),
    "posenet_noisy": guard(posenet.fit_noisy),
    "odometry": guard(odometry_labels.fit),
    "knn": guard(knn.fit),
    "pca_knn": guard(pca_knn.fit),
    "explicit": guard(explicit.fit),
    "explicit_mds": guard(explicit.fit_from_mds),
}
