"""The method in one file, an example: it learns a drive past made-up lamps, and rooms about as well as ``deepgps``."""

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings
from deepgps.methods.fit import fit_method
from sim.recording.collect import collect
from sim.recording.format import open_recording
from sim.settings import CameraSettings, DriveSettings, GridSettings, RoomSettings, SimSettings

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "deepgps_from_scratch.py"
WIDTH_M, DEPTH_M, SPACING_M, RINGS, SECTORS = 2.4, 2.0, 0.08, 8, 32
ROOM = SimSettings(
    room=RoomSettings(kind="bedroom", width_m=3.2, depth_m=2.8),
    camera=CameraSettings(rings=RINGS, sectors=SECTORS, face_px=16),
    drive=DriveSettings(samples=1000),
    grid=GridSettings(spacing_m=0.3, headings=2),
)
"""With a fifth of these images, the map is ambiguous: even the true one is not where segments fit best."""


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("deepgps_from_scratch", EXAMPLE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def see(pose: np.ndarray) -> np.ndarray:
    """Polar images (n, rings, sectors, 3) at poses (n, 3) under forty coloured lamps."""
    rng = np.random.default_rng(1)
    lamp, colour = rng.uniform(-2.5, 2.5, (40, 2)), rng.uniform(0.2, 1.0, (40, 3))
    ahead, left = np.moveaxis(lamp - pose[:, None, :2], 2, 0)
    ring = np.arctan(np.hypot(ahead, left) / 1.5)[..., None] / (np.pi / 2) * RINGS - np.arange(RINGS) - 0.5
    bearing = (np.arctan2(left, ahead) - pose[:, 2:])[..., None]
    sector = np.cos(bearing - 2 * np.pi * (np.arange(SECTORS) + 0.5) / SECTORS)
    light = np.einsum("nlr,nls,lc->nrsc", np.exp(-(ring**2)), np.exp(8.0 * (sector - 1.0)), colour)
    return np.clip(120.0 * light, 0.0, 255.0).astype(np.uint8)


def write_recording(folder: Path, segments: int = 60) -> None:
    """A drive from wall to wall of an empty room, of which the file reads what its docstring says."""
    rng = np.random.default_rng(0)
    half = np.array([WIDTH_M, DEPTH_M]) / 2
    here, driven, poses, readings = np.zeros(2), 0.0, [np.zeros(3)], []
    for segment in range(segments):
        yaw = np.arctan2(*(rng.uniform(-half, half) - here)[::-1])
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        steps = int((((np.sign(ahead) * half - here) / ahead).min()) / SPACING_M)
        readings.append((segment, len(poses) - 1, driven))
        for _ in range(steps):
            here, driven = here + SPACING_M * ahead, driven + SPACING_M
            readings.append((segment, len(poses), driven))
            poses.append(np.array([*here, yaw]))
    pose, rows = np.array(poses), np.array(readings)
    ticks = rows[:, 2:] / (2 * np.pi * 0.033) * 4096
    grid = np.stack(np.meshgrid(np.arange(-1.0, 1.1, 0.25), np.arange(-0.75, 0.8, 0.25)), axis=-1).reshape(-1, 2)
    test = np.stack([np.c_[grid, np.full(len(grid), yaw)] for yaw in (0.3, 2.0)], axis=1)
    arrays = {
        "observations/fisheye": see(pose),
        "reading": np.concatenate([rows[:, :2], ticks, ticks], axis=1).round().astype(np.int64),
        "test/fisheye": see(test.reshape(-1, 3)).reshape(*test.shape[:2], RINGS, SECTORS, 3),
        "truth/pose": pose,
        "truth/test_pose": test,
    }
    for name, array in arrays.items():
        path = folder / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, array)
    odometry = {"wheel_radius_m": 0.033, "ticks_per_rev": 4096}
    (folder / "manifest.json").write_text(json.dumps({"odometry": odometry}))


def test_a_drive_past_lamps_is_learned_without_the_truth_and_drawn(
    example: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write_recording(tmp_path)
    monkeypatch.setattr(example, "STEPS", 200)
    monkeypatch.setattr(example, "WIDTH", 64)
    (tmp_path / "truth").rename(tmp_path / "hidden")
    methods = example.learn(tmp_path)
    (tmp_path / "hidden").rename(tmp_path / "truth")
    for name, most in (("network", 0.05), ("nearest image", 0.05), ("registration", 0.01)):
        true, found = example.measure(tmp_path, methods[name])
        assert np.median(np.linalg.norm(found - true, axis=1)) < most, name
    example.draw(tmp_path / "map.svg", true, found)
    assert (tmp_path / "map.svg").read_text().count("M") == len(true)


@pytest.mark.slow
def test_a_room_is_learned_about_as_well_as_by_deepgps(example: ModuleType, tmp_path: Path):
    collect(ROOM, 1, tmp_path / "recording", lambda *_: None, workers=1)
    settings = LearnSettings.model_validate({"train": {"steps": 1000, "segments": 16}, "network": {"layers": 4}})
    recording = open_recording(tmp_path / "recording")
    ours = fit_method("deepgps", recording, settings, 0, tmp_path / "deepgps")
    methods = example.learn(tmp_path / "recording")
    for figure in (np.median, lambda error: np.sqrt(np.mean(error**2))):
        by_network, by_registration, by_deepgps = (
            figure(np.linalg.norm(np.subtract(*example.measure(tmp_path / "recording", locate)), axis=1))
            for locate in (methods["network"], methods["registration"], ours)
        )
        assert by_network < 1.2 * by_deepgps and by_registration < by_network, (by_network, by_registration, by_deepgps)
