"""What many tests share: the renderer chosen before MuJoCo is imported, a small recording, and a finished run."""

import os
from pathlib import Path

import hypothesis
import pytest

from sim.sensors.camera.gl import choose_backend
from sim.settings import CameraSettings, DriveSettings, GridSettings, RoomSettings, SimSettings
from tests.helpers.made_once import make_once

choose_backend()
# Two workers of pytest share two cores: a library that starts threads of its own in each only makes both wait.
for name in ("OMP_NUM_THREADS", "LP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "0" if name.startswith("LP") else "1")
hypothesis.settings.register_profile("deepgps", deadline=None)  # no test is timed
hypothesis.settings.load_profile("deepgps")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # before torch, as in deepgps.commands.main

SMALL = SimSettings(
    room=RoomSettings(kind="bedroom", width_m=3.2, depth_m=2.8),
    camera=CameraSettings(rings=8, sectors=32, face_px=16),
    drive=DriveSettings(samples=300),
    grid=GridSettings(spacing_m=0.4, headings=2),
)


@pytest.fixture(autouse=True)
def without_plugins():
    """Forget the plugins that a test has loaded: no other test knows of them."""
    from deepgps.config.methods import METHODS
    from sim.plugins import ENCODER_FAULTS

    methods, faults = dict(METHODS), dict(ENCODER_FAULTS)
    yield
    METHODS.clear()
    METHODS.update(methods)
    ENCODER_FAULTS.clear()
    ENCODER_FAULTS.update(faults)


@pytest.fixture(scope="session")
def small_settings() -> SimSettings:
    return SMALL


@pytest.fixture(scope="session")
def small_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a small room, driven and rendered for real."""
    from sim.recording.collect import collect

    def make(folder: Path) -> None:
        collect(SMALL, 0, folder / "recording", lambda *_: None, workers=1)

    return make_once(tmp_path_factory, "small", make) / "recording"


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the mini scenario, by the command in a process of its own; ``said.txt`` beside it is what it printed."""
    from tests.helpers.command import MINI, deepgps

    def make(folder: Path) -> None:
        (folder / "mini.yaml").write_text(MINI)
        done = deepgps("run", "mini.yaml", "--out", "run", cwd=folder)
        assert done.returncode == 0, done.stderr
        (folder / "said.txt").write_text(done.stdout)

    return make_once(tmp_path_factory, "mini", make) / "run"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with the most slow tests first, so that no worker is left with a long one at the end."""
    slow: dict[Path, int] = {}
    for item in items:
        slow[item.path] = slow.get(item.path, 0) + (item.get_closest_marker("slow") is not None)
    items.sort(key=lambda item: -slow[item.path])
