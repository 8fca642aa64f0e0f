"""A box with painted walls and pillars, seen by an upward fisheye without a renderer, and a positioner for it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from deepgps.config.learning import FeatureSettings, PixelValues
from deepgps.data.features import fit_features
from deepgps.data.segments import read_segments
from deepgps.learning.batches import Inputs
from deepgps.learning.trainer import make_generator
from deepgps.learning.training_data import TrainingData
from deepgps.methods.appearance import learn
from deepgps.methods.registration import find_headings
from deepgps.positioner.positioner import NeighbourPositioner
from sim.recording.format import Recording
from sim.recording.turns import Turns
from sim.sensors.camera.lens import make_lens, polar_rays
from sim.sensors.camera.mount import tilt
from sim.settings import CameraSettings

SIZE_M = np.array([3.0, 2.5, 2.0])
CAMERA_DEPTH_M = 0.35
RADIUS_M, HEIGHT_M = 0.2, 1.2
RINGS, SECTORS = 16, 64
STEP_M = 0.08
PILLARS = ((0.3, 0.3), (2.7, 2.2), (2.7, 0.3), (0.3, 1.4))
MOVED_PILLARS = ((1.5, 0.2), (2.8, 1.2), (0.2, 2.2), (1.2, 2.3))
LOW_CORNER, HIGH_CORNER = np.array([0.7, 0.65]), np.array([2.3, 1.85])
"""Corners of the floor that is driven [m]."""


@dataclass(frozen=True)
class Room:
    """A box whose colours are sums of waves; pillars are of one colour each."""

    seed: int = 0
    pillars: Sequence[tuple[float, float]] = PILLARS

    def photograph(self, pose: np.ndarray, lean: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Polar images (N, rings, sectors, 3) uint8 at poses (N, 3): x, y [m], yaw [rad]; lean as the camera's."""
        rays = polar_rays(make_lens(CameraSettings()), RINGS, SECTORS) @ tilt(np.array(lean)).T
        return np.stack([self._photograph(x, y, yaw, rays) for x, y, yaw in pose.tolist()])

    def _photograph(self, x: float, y: float, yaw: float, rays: np.ndarray) -> np.ndarray:
        c, s = np.cos(yaw), np.sin(yaw)
        ray = np.stack([c * rays[..., 0] - s * rays[..., 1], s * rays[..., 0] + c * rays[..., 1], rays[..., 2]], -1)
        eye, low = np.array([x, y, 0.0]), np.array([0.0, 0.0, -CAMERA_DEPTH_M])
        wall = np.where(ray > 0.0, SIZE_M - eye, low - eye) / np.where(np.abs(ray) > 1e-9, ray, 1e-9)
        far = wall.min(axis=-1)
        picture = self._paint(eye + far[..., None] * ray)
        flat = np.hypot(ray[..., 0], ray[..., 1])
        for number, (px, py) in enumerate(self.pillars):
            along = ((px - x) * ray[..., 0] + (py - y) * ray[..., 1]) / np.maximum(flat, 1e-9) ** 2
            aside = np.abs((px - x) * ray[..., 1] - (py - y) * ray[..., 0]) / np.maximum(flat, 1e-9)
            hit = (along > 0.0) & (aside < RADIUS_M) & (along * ray[..., 2] < HEIGHT_M) & (along < far)
            picture[hit] = (30.0 + 40.0 * number, 200.0 - 50.0 * number, 90.0)
        return np.clip(picture, 0.0, 255.0).astype(np.uint8)

    def _paint(self, place: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(self.seed)
        wave, phase = rng.normal(0.0, 5.0, (3, 3, 8)), rng.uniform(0.0, 2.0 * np.pi, (3, 8))
        return 120.0 + 18.0 * np.cos(np.einsum("rsk,kcw->rscw", place, wave) + phase).sum(axis=-1)


def drive(
    like: Recording,
    room: Room,
    segments: int,
    seed: int,
    lean: tuple[float, float] = (0.0, 0.0),
    high: np.ndarray = HIGH_CORNER,
) -> Recording:
    """A recording of a drive between places up to ``high`` with a turn in place at each; ``like`` has its manifest."""
    rng, pose, readings, turned, turns = np.random.default_rng(seed), [], [], [], []
    here, distance = LOW_CORNER, 0.0
    for segment in range(segments):
        target = rng.uniform(LOW_CORNER, high)
        length = max(np.linalg.norm(target - here), 1e-6)
        ahead, yaw = (target - here) / length, np.arctan2(*(target - here)[::-1])
        if segment:
            turns.append((len(pose) - 1, len(turned), len(readings), 0))
            turned.append([*here, yaw])
        else:
            pose.append([*here, yaw])
        readings.append((segment, len(pose) - 1, distance))
        for _ in range(max(2, int(length / STEP_M))):
            here, distance = here + STEP_M * ahead, distance + STEP_M
            pose.append([*here, yaw])
            readings.append((segment, len(pose) - 1, distance))
    places, odometry = np.array(pose), like.manifest.odometry
    number = np.array(readings)
    ticks = number[:, 2] / (2.0 * np.pi * odometry["wheel_radius_m"]) * odometry["ticks_per_rev"]
    reading = np.column_stack([number[:, :2], ticks, ticks]).astype(np.int64)
    return replace(
        like,
        observation=room.photograph(places, lean),
        reading=reading,
        time=number[:, 2] * 5.0,
        observation_time=None,
        turns=Turns(*np.array(turns).T),
        turn_observation=room.photograph(np.array(turned), lean),
        others={"place": places[:, :2]},
    )


def train(recording: Recording, values: PixelValues) -> NeighbourPositioner:
    """Nearest neighbours with the true places of a recording by ``drive``, and what is seen where."""
    segments, places = read_segments(recording), recording.others["place"]
    settings = FeatureSettings(values=values, principal=64, components=32)
    features, known = fit_features(recording.observation, segments, settings, make_generator(0, "features"))
    data = TrainingData(segments, features, known, Inputs(known), recording.observation)
    appearance, _ = learn(data, places, find_headings(recording, places))
    return NeighbourPositioner(features, known, torch.from_numpy(places), 4, appearance=appearance)
