"""Labels for supervised methods: a recording's own labels if it has any, otherwise the simulator's ground truth."""

import numpy as np
import torch

from sim.errors import InputError
from sim.recording.format import Recording, open_labels, open_truth


def read_places(recording: Recording) -> tuple[torch.Tensor, torch.Tensor]:
    """Labelled observations (n,) and their positions (n, 2) float64 [m]; raises InputError if none has a label."""
    labels = open_labels(recording.folder)
    place = (open_truth(recording.folder).pose if labels is None else labels.pose)[:, :2]
    known = np.flatnonzero(np.isfinite(place).all(axis=1))
    if not len(known):
        raise InputError(f"{recording.folder}: no observation has a label, so there is nothing to learn from")
    return torch.from_numpy(known), torch.from_numpy(place[known].astype("float64"))
