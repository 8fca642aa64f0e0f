"""The methods by name. Each learns only from readings that can be, and gives the same bytes on any number of cores."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path

from deepgps import deepgps, explicit, knn, odometry, pca_knn, posenet
from deepgps.features import check_observations
from deepgps.positioner import Positioner, is_finished
from deepgps.progress import Report, ignore
from deepgps.readings import keep_plausible
from deepgps.settings import LearnSettings
from deepgps.train import use_threads
from sim.records import Recording

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
    "odometry": guard(odometry.fit),
    "knn": guard(knn.fit),
    "pca_knn": guard(pca_knn.fit),
    "explicit": guard(explicit.fit),
    "explicit_mds": guard(explicit.fit_from_mds),
}
