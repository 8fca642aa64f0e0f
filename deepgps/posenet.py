"""PoseNet, the supervised rival (Kendall et al. 2015; paper Eq. 1): the same network, trained on positions."""

from pathlib import Path

from deepgps.labels import read_places
from deepgps.positioner import Positioner
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from deepgps.supervised import fit_positions
from sim.records import Recording


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train on labels, or on true positions where there are none; done work is loaded, cut-off work continued."""
    index, place = read_places(recording)
    return fit_positions(recording, index, place.float(), settings, seed, folder, progress, "posenet")
