"""The methods by name."""

from collections.abc import Callable
from pathlib import Path

from deepgps import deepgps, explicit, knn, odometry, pca_knn, posenet
from deepgps.positioner import Positioner
from deepgps.progress import Report
from deepgps.settings import LearnSettings
from sim.records import Recording

Fit = Callable[[Recording, LearnSettings, int, Path, Report], Positioner]

METHODS: dict[str, Fit] = {
    "deepgps": deepgps.fit,
    "deepgps_aware": deepgps.fit_aware,
    "deepgps_turns": deepgps.fit_turns,
    "posenet": posenet.fit,
    "posenet_noisy": posenet.fit_noisy,
    "odometry": odometry.fit,
    "knn": knn.fit,
    "pca_knn": pca_knn.fit,
    "explicit": explicit.fit,
    "explicit_mds": explicit.fit_from_mds,
}
