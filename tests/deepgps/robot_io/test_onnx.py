"""A method written as ONNX: the same poses in onnxruntime as in torch, by the example that the folder holds."""

import importlib
import json
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import get_args

import cv2
import numpy as np
import pytest
import torch

import deepgps
from deepgps.config.learning import Architecture, FeatureSettings, LearnSettings, NetworkSettings, PixelValues
from deepgps.data.features import Features
from deepgps.learning.networks import make_network
from deepgps.methods.fit import fit_method
from deepgps.positioner.pose import Poses, find_poses
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.positioner.registration import REASONS
from deepgps.positioner.without_features import LandmarkPositioner
from deepgps.robot_io.export import MODULES, OUTPUTS, Deployed, FeatureModule, write_onnx
from sim.alignment import Alignment
from sim.errors import InputError
from sim.geometry import wrap
from sim.recording.format import open_recording
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.mount import Upright
from sim.sensors.camera.unwrap import RoundImage, unwrap_fisheye

MIRRORING = Alignment(np.array([[0.6, 0.8], [0.8, -0.6]]), np.array([2.0, -1.0]), 1.0)
"""Into a mirrored frame."""
RAW = RoundImage((60.0, 58.0), 50.0, 20.0)


def load_example(folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The example in an exported folder, with the modules beside it."""
    monkeypatch.syspath_prepend(str(folder))
    for name in ("example", *MODULES):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module("example")


def assert_alike(found: dict[str, np.ndarray], expected: Poses) -> None:
    """Assert that poses agree to what float32 holds: 1e-4 m and radians.

    Of so few training images many look alike, and rounding may lead a few of the others to another mode.
    """
    assert set(found) == set(OUTPUTS)
    assert expected.reason is not None
    same = np.array([REASONS[one] for one in expected.reason]) == found["reason"]
    assert same.mean() >= 0.7
    np.testing.assert_array_equal(found["accepted"], found["reason"] == "accepted")
    for name in set(OUTPUTS) - {"accepted", "reason"}:
        away = np.asarray(found[name], float) - np.asarray(vars(expected)[name], float)
        away = np.abs(wrap(away) if name == "yaw" else away).reshape(len(same), -1).max(axis=1)
        assert np.median(away) < 1e-4, name


@pytest.fixture(scope="module")
def run(finished_run: Path) -> deepgps.Run:
    return deepgps.load(finished_run)


@pytest.fixture(scope="module")
def leaning(run: deepgps.Run) -> NetworkPositioner:
    """A trained positioner as of a camera that leans and sits ahead of the axle."""
    positioner = run.positioner("deepgps_compass")
    assert isinstance(positioner, NetworkPositioner)
    return replace(positioner, upright=Upright(Lens(1.6), (0.05, -0.03)), mount=(0.04, -0.02))


@pytest.fixture(scope="module")
def images(run: deepgps.Run) -> np.ndarray:
    """Test images."""
    images = run.recording.test_observation
    return images.reshape(-1, *images.shape[2:])[:60]


@pytest.fixture(scope="module")
def exported(leaning: NetworkPositioner, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("onnx")
    write_onnx(folder, "deepgps_compass", leaning, MIRRORING, RAW)
    return folder


def test_the_module_gives_the_positions_and_features_of_the_positioner(leaning: NetworkPositioner, images: np.ndarray):
    assert leaning.upright is not None and leaning.appearance is not None
    upright = leaning.upright(images)
    with torch.inference_mode():
        found = Deployed(leaning).eval()(torch.from_numpy(upright))
    np.testing.assert_allclose(found["position"].numpy(), leaning.locate_camera(images), atol=1e-4)
    expected = leaning.appearance.features.apply(upright)
    torch.testing.assert_close(found["features"], expected, rtol=1e-3, atol=1e-2 * float(expected.abs().max()))


def test_features_in_the_module_are_those_of_the_method():
    rng = np.random.default_rng(1)
    for sectors, values in product((7, 32), get_args(PixelValues)):
        images = rng.integers(0, 256, (4, 5, sectors, 3), dtype=np.uint8)
        images[0], count = 200, min(16, sectors // 2)
        size = 5 * 3 * (count + 1) + 2 * 4 * 3 * count
        mean, basis = (torch.from_numpy(rng.normal(size=shape).astype(np.float32)) for shape in (size, (size, 6)))
        features = Features((5, sectors, 3), 16, mean, basis, values=values)
        found = FeatureModule(features)(torch.from_numpy(images).float())
        torch.testing.assert_close(found, features.apply(images), rtol=1e-4, atol=1e-3)


@pytest.mark.slow
def test_the_example_finds_the_same_poses_of_polar_and_raw_images(
    exported: Path, leaning: NetworkPositioner, images: np.ndarray, monkeypatch: pytest.MonkeyPatch
):
    locator = load_example(exported, monkeypatch).Locator()
    found = [locator.locate(image) for image in images]
    expected = find_poses(leaning, images).align(MIRRORING)
    away = np.linalg.norm(np.stack([one["position"] for one in found]) - expected.position, axis=1)
    assert np.median(away) < 1e-3, "of so few training images most look alike, and yaws may differ"
    raw = np.random.default_rng(2).integers(0, 256, (120, 130, 3), dtype=np.uint8)
    raw = cv2.GaussianBlur(raw, (0, 0), 4.0)
    rings, sectors, _ = leaning.shape
    one = locator.locate(raw)
    other = locator.locate(unwrap_fisheye(raw, RAW.centre, RAW.radius_px, rings, sectors, RAW.forward_deg))
    for name in ("position", "yaw"):
        np.testing.assert_array_equal(one[name], other[name], "raw images are unwrapped as the testbed does")
    assert not any("deepgps" in line for file in exported.glob("*.py") for line in imports(file))
    meta = json.loads((exported / "meta.json").read_text())
    assert (meta["method"], meta["frame"], meta["image"]) == ("deepgps_compass", "world", [8, 32, 3])
    assert meta["raw"] == {"centre_px": [60.0, 58.0], "radius_px": 50.0, "forward_deg": 20.0}
    assert meta["mirrored"] != leaning.mirrored, "the frame is mirrored"
    assert set(meta["outputs"]) == set(OUTPUTS)


def imports(file: Path) -> list[str]:
    return [line for line in file.read_text().splitlines() if line.startswith(("import ", "from "))]


@pytest.mark.slow
def test_registration_is_written_too(small_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recording = open_recording(small_recording)
    images = recording.test_observation.reshape(-1, *recording.test_observation.shape[2:])[:60]
    settings = LearnSettings(features=FeatureSettings(principal=128, components=48))
    labelled = fit_method("registration_labels", recording, settings, 0, tmp_path / "registration_labels")
    write_onnx(tmp_path / "onnx", "registration_labels", labelled, None, None)
    locator = load_example(tmp_path / "onnx", monkeypatch).Locator()
    found = [locator.locate(image) for image in images]
    assert_alike({name: np.stack([one[name] for one in found]) for name in found[0]}, find_poses(labelled, images))


def image_positioner(architecture: Architecture) -> NetworkPositioner:
    """An untrained network on images."""
    settings = NetworkSettings(architecture=architecture, channels=4)
    network = make_network(settings, 0, 2, torch.Generator().manual_seed(0)).eval()
    return NetworkPositioner((16, 32, 3), None, settings, network, torch.zeros(2), torch.eye(2))


def test_networks_on_images_give_their_positions():
    images = np.random.default_rng(3).integers(0, 256, (3, 16, 32, 3), dtype=np.uint8)
    for architecture in sorted(set(get_args(Architecture)) - {"spectral"}):
        positioner = image_positioner(architecture)
        with torch.inference_mode():
            found = Deployed(positioner)(torch.from_numpy(images))
        assert list(found) == ["position"]
        np.testing.assert_allclose(found["position"].numpy(), positioner(images), atol=1e-4)


@pytest.mark.slow
def test_a_network_on_images_is_written_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    positioner = image_positioner("invariant")
    write_onnx(tmp_path, "deepgps_compass", positioner, None, None)
    image = np.random.default_rng(3).integers(0, 256, (16, 32, 3), dtype=np.uint8)
    found = load_example(tmp_path, monkeypatch).Locator().locate(image)["position"]
    np.testing.assert_allclose(found, positioner(image[None])[0], atol=1e-4)


def test_what_cannot_be_written_is_refused_in_one_line(
    leaning: NetworkPositioner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with pytest.raises(InputError, match="--onnx: method knn is neither a network nor registration on polar images"):
        write_onnx(tmp_path, "knn", LandmarkPositioner(np.zeros((3, 2)), np.inf), None, None)
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(InputError, match="--onnx needs pip install onnx onnxscript onnxruntime"):
        write_onnx(tmp_path, "deepgps_compass", leaning, None, None)
    assert list(tmp_path.iterdir()) == []
