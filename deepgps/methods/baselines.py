"""Baselines: PoseNet, nearest neighbours on features, PCA with KNN, and what the encoders alone would teach.

Only these learn from labels. PoseNet (Kendall et al. 2015; paper Eq. 1) is DeepGPS's network with its inputs, steps and
loop, trained on positions; dead-reckoned positions are such labels too. PCA with KNN is the paper's baseline on scans
(its appendix): a map of stored scans at many headings. Turning the robot by a whole number of rays shifts the scan in a
circle, so the many headings need not be observed. They are stored all the same, each as its principal components, which
is what the method's memory holds.
"""

from pathlib import Path

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.labels import read_places
from deepgps.data.segments import dead_reckon, leave_held_out
from deepgps.learning.trainer import make_generator
from deepgps.learning.training_data import prepare
from deepgps.methods.registration import find_headings, finish
from deepgps.methods.regression import fit_positions
from deepgps.positioner.positioner import Fitted, NeighbourPositioner
from deepgps.positioner.without_features import ScanPositioner
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.recording.format import Recording
from sim.rng import stream


def fit_dead_reckoned(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> Fitted:
    """Train on dead-reckoned positions."""
    # Where the robot turns, one observation has two readings; either gives its label. Lost readings give no label.
    index, first = np.unique(recording.reading[:, 1], return_index=True)
    place = dead_reckon(recording)[first, :2].astype(np.float32)
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, torch.from_numpy(index), torch.from_numpy(place), settings, seed, folder, progress)


NEIGHBOURS = 4  # Number of stored positions that are averaged


def fit_knn(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Store features and positions of the labelled observations, without those on segments held out."""
    data = prepare(recording, settings, seed, folder.parent)
    index, places = leave_held_out(*read_places(recording), data.segments, len(data.features))
    features = data.features[index]
    progress(folder.name, 1, 1)
    positioner = NeighbourPositioner(data.projection, features, places, NEIGHBOURS)
    return Fitted(positioner, {"parameters": features.numel() + places.numel()})


FITTED_SCANS = 50_000  # Approximate maximum number of scans from which the principal components are computed
CHUNK = 100
COMPONENTS = 128  # Principal components of a scan, as in the paper


def fit_pca_knn(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Store the scans of all positions at random headings; raises InputError if there are none, or all are the same."""
    index, labels = read_places(recording)
    scans, rng = np.asarray(recording.observation)[index.numpy()], stream(seed, "features")
    count, kept, rays = scans.shape
    if (scans == scans[:1]).all():
        raise InputError(f"all {count} observations look alike, so none tells where it was")
    turns = draw_turns(count, kept * rays, settings.pca.headings, rng)
    places = labels.numpy()
    mean, axes = find_axes(scans, turns, COMPONENTS)
    headings = turns.shape[1]
    known = np.empty((count * headings, len(axes)), np.float32)
    positioner = ScanPositioner(mean, axes, known, places, headings)
    for first in range(0, count, CHUNK):
        turned = turn_scans(scans[first : first + CHUNK], turns[first : first + CHUNK])
        known[first * headings : first * headings + len(turned)] = positioner.project(turned)
        progress(folder.name, min(first + CHUNK, count), count)
    return Fitted(positioner, {"parameters": sum(tensor.numel() for tensor in positioner.pack().tensors.values())})


def draw_turns(count: int, possible: int, wanted: int, rng: np.random.Generator) -> np.ndarray:
    """Draw distinct turns (count, n) for ``count`` places: ``wanted`` of the ``possible`` ones, or all of them."""
    if wanted >= possible:
        return np.tile(np.arange(possible), (count, 1))
    return rng.permuted(np.tile(np.arange(possible), (count, 1)), axis=1)[:, :wanted]


def turn_scans(scans: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Scans (n h, rays) [m] as seen after the robot, which saw (n, headings, rays) [m], has turned left.

    Turns (n, h) are in units of the angle between two rays divided by the number of headings.
    """
    _, headings, rays = scans.shape
    ray = (np.arange(rays) + turns[..., None] // headings) % rays
    place = np.arange(len(scans))[:, None, None]
    return scans[place, (turns % headings)[..., None], ray].reshape(-1, rays)


def find_axes(scans: np.ndarray, turns: np.ndarray, components: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean (rays,) and principal axes (components, rays) of scans (N, headings, rays) at turns (N, h)."""
    from sklearn.decomposition import PCA

    some = turn_scans(scans, turns[:, : max(1, FITTED_SCANS // len(scans))])
    found = PCA(min(components, *some.shape), svd_solver="covariance_eigh").fit(some)
    return np.asarray(found.mean_, np.float32), np.asarray(found.components_, np.float32)


LABEL_NOISE_M = 0.01  # Standard deviation of a noisy label, in x and in y [m]


def fit_posenet(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train on labels, or on true positions if the recording has no labels."""
    index, place = read_places(recording)
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, index, place.float(), settings, seed, folder, progress)


def fit_posenet_noisy(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> Fitted:
    """Train on labels with a surveyor's errors: Gaussian noise of ``LABEL_NOISE_M`` in x and in y."""
    index, place = read_places(recording)
    noise = torch.randn(place.shape, generator=make_generator(seed, "labels"))
    place = place.float() + LABEL_NOISE_M * noise
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, index, place, settings, seed, folder, progress)


def fit_registration(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> Fitted:
    """Registration on labels, or on true positions if the recording has no labels."""
    data = prepare(recording, settings, seed, folder.parent)
    index, label = read_places(recording)
    places = np.full((len(recording.observation), 2), np.nan)
    places[index.numpy()] = label.numpy()
    return finish(data, places, find_headings(recording, places), progress, folder)
