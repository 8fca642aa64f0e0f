"""DeepGPS that also uses the turns between segments: it starts from the dead-reckoned path and is never mirrored."""

from pathlib import Path

import torch

from deepgps.config.learning import LearnSettings, Start
from deepgps.data.segments import Segments
from deepgps.diagnosis.store import take_diagnosed
from deepgps.initial_map.distances.wheel_turns import find_chirality, read_turns, straighten
from deepgps.learning.training_data import prepare
from deepgps.methods.deepgps import Variant, fit_data, make_initial_map
from deepgps.positioner.positioner import Fitted
from deepgps.terminal.progress import Report
from sim.recording.format import Recording
from sim.rng import stream


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train DeepGPS from the dead-reckoned path, with the chirality that the wheels' turns determine."""
    recording, record = take_diagnosed(recording, folder.parent)
    data, turns = prepare(recording, settings, seed, folder.parent), read_turns(recording)

    def start_from_path(
        features: torch.Tensor, segments: Segments, start: Start, seed: int, number: int
    ) -> tuple[torch.Tensor, Segments]:
        if start != "paths" or number > 0:
            return make_initial_map(features, segments, start, seed, number)
        relaxed = straighten(turns, features, segments, stream(seed, "start"))
        return torch.from_numpy(relaxed.places), relaxed.segments

    def orient(positions: torch.Tensor) -> int:
        return find_chirality(positions.double().numpy(), data.segments, turns.angle)

    variant = Variant(make_initial_map=start_from_path, orient=orient)
    return fit_data(data, variant, settings, seed, folder, progress).note(record)
