"""A plane world for tests of learning: distances to landmarks as observations, straight drives, exact encoders."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from deepgps.config.learning import FeatureSettings
from deepgps.data.features import fit_features
from deepgps.data.segments import Segments, read_segments
from sim.geometry import FreeSpace, save_free_space
from sim.recording.format import Recording, open_recording, write_files

SIZE_M = (3.0, 2.0)
SPACING_M = 0.08
ODOMETRY = {"wheel_radius_m": 0.033, "track_m": 0.16, "ticks_per_rev": 65536}
M_PER_TICK = 2.0 * np.pi * ODOMETRY["wheel_radius_m"] / ODOMETRY["ticks_per_rev"]
QUICK = {
    "network": {"width": 64, "layers": 2},
    "train": {"steps": 300, "segments": 16, "samples": 8, "learning_rate": 3e-3, "checkpoint_steps": 50},
    "features": {"noise": 0.02},
}


def make_toy(folder: Path, samples: int = 1200, endpoint: bool = False, seed: int = 0) -> Recording:
    """Drive a rectangle and write a recording; ``endpoint`` keeps only where a segment begins and ends."""
    rng = np.random.default_rng(seed)
    landmark = rng.uniform(-0.5, 0.5, (12, 2)) * SIZE_M
    pose, reading = _drive(samples, endpoint, rng)
    grid = np.stack(np.meshgrid(np.linspace(-1.4, 1.4, 15), np.linspace(-0.9, 0.9, 10)), axis=-1).reshape(-1, 2)
    test_pose = np.concatenate([grid, np.zeros((len(grid), 1))], axis=1)[:, None]
    space = FreeSpace(np.zeros(2), 0.1, np.ones((3, 3), bool), np.ones((3, 3), bool), np.zeros(2), SIZE_M[1])
    folder.mkdir(parents=True)
    (folder / "truth").mkdir()
    save_free_space(folder / "truth" / "free_space.npz", space)
    arrays = {
        "observations/landmarks.npy": observe(pose, landmark),
        "reading.npy": reading,
        "time.npy": np.arange(len(reading), dtype=float),
        "test/landmarks.npy": observe(test_pose[:, 0], landmark)[:, None],
        "truth/pose.npy": pose,
        "truth/reading.npy": reading[:, :2],
        "truth/wheel_angle.npy": reading[:, 2:] / ODOMETRY["ticks_per_rev"] * 2.0 * np.pi,
        "truth/test_pose.npy": test_pose,
        "truth/state.npy": pose,
    }
    write_files(folder, arrays, {"sensors": {"landmarks": "vector"}, "odometry": ODOMETRY})
    return open_recording(folder)


def observe(pose: np.ndarray, landmark: np.ndarray) -> np.ndarray:
    """Distances of poses (N, 3) to landmarks (M, 2): (N, M) float32."""
    return np.linalg.norm(pose[:, None, :2] - landmark, axis=-1).astype(np.float32)


def _drive(samples: int, endpoint: bool, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    place, yaw, ticks, segment = np.zeros(2), 0.0, np.zeros(2), 0
    pose, reading = [np.zeros(3)], []
    while len(pose) < samples:
        turn = rng.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(yaw + turn), np.sin(yaw + turn)])
        with np.errstate(divide="ignore"):
            room = float(np.min((np.sign(direction) * np.array(SIZE_M) / 2 - place) / direction))
        steps = int(min(room, 3.0) / SPACING_M)
        if steps < 3:
            continue
        yaw += turn
        ticks = ticks + np.array([-1.0, 1.0]) * turn * ODOMETRY["track_m"] / 2.0 / M_PER_TICK
        reading.append([segment, len(pose) - 1, *np.rint(ticks)])
        for distance in [steps * SPACING_M] if endpoint else np.arange(1, steps + 1) * SPACING_M:
            pose.append(np.array([*(place + distance * direction), yaw]))
            reading.append([segment, len(pose) - 1, *np.rint(ticks + distance / M_PER_TICK)])
        place, ticks, segment = (
            place + steps * SPACING_M * direction,
            ticks + steps * SPACING_M / M_PER_TICK,
            segment + 1,
        )
    return np.array(pose), np.array(reading, np.int64)


class DescribedToy(NamedTuple):
    """A toy's features, its segments and the true places of its observations (N, 2) [m]."""

    features: torch.Tensor
    segments: Segments
    place: np.ndarray


def describe_toy(folder: Path, samples: int) -> DescribedToy:
    recording = make_toy(folder, samples)
    segments, generator = read_segments(recording), torch.Generator().manual_seed(0)
    _, features = fit_features(recording.observation, segments, FeatureSettings(components=10), generator)
    return DescribedToy(features, segments, np.load(folder / "truth" / "pose.npy")[:, :2])
