"""What many tests share: the renderer chosen before MuJoCo is imported, a recording, a finished run and a study."""

import os
import signal
import sys
from pathlib import Path

import hypothesis
import pytest

from sim.sensors.camera.gl import choose_backend
from sim.settings import CameraSettings, DriveSettings, GridSettings, RoomSettings, SimSettings
from tests.helpers.made_once import make_once
from tests.helpers.processor_time import ProcessorTime
from tests.helpers.time_limit import TimeLimit

choose_backend()
# Two workers of pytest share two cores: a library that starts threads of its own in each only makes both wait.
for name in ("OMP_NUM_THREADS", "LP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "0" if name.startswith("LP") else "1")
hypothesis.settings.register_profile("deepgps", deadline=None)  # no test is timed
hypothesis.settings.load_profile("deepgps")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # before torch, as in deepgps.commands.main
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    # As for a script's job in the background. Processes would inherit that, but not a handler that ignores it.
    signal.signal(signal.SIGINT, lambda *_: None)

SMALL_WORLD = SimSettings(
    room=RoomSettings(kind="bedroom", width_m=3.2, depth_m=2.8),
    camera=CameraSettings(rings=8, sectors=32, face_px=16),
    drive=DriveSettings(samples=300),
    grid=GridSettings(spacing_m=0.4, headings=2),
)


@pytest.fixture(autouse=True)
def without_plugins():
    """Forget the plugins that a test has loaded: no other test knows of them."""
    from deepgps.config.methods import METHODS
    from sim.plugins import ENCODER_FAULTS, MODULE_PREFIX

    methods, faults = dict(METHODS), dict(ENCODER_FAULTS)
    yield
    for name in [name for name in sys.modules if name.startswith(MODULE_PREFIX)]:
        del sys.modules[name]
    METHODS.clear()
    METHODS.update(methods)
    ENCODER_FAULTS.clear()
    ENCODER_FAULTS.update(faults)


@pytest.fixture(scope="session")
def small_settings() -> SimSettings:
    return SMALL_WORLD


@pytest.fixture(scope="session")
def small_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a small room, driven and rendered for real."""
    from sim.recording.collect import collect

    def make(folder: Path) -> None:
        collect(SMALL_WORLD, 0, folder / "recording", lambda *_: None, workers=1)

    return make_once(tmp_path_factory, "small", make) / "recording"


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the mini scenario, by the command in a process of its own; ``said.txt`` beside it is what it printed."""
    from tests.helpers.command import MINI, make_by_command

    def make(folder: Path) -> None:
        (folder / "mini.yaml").write_text(MINI)
        make_by_command("run", "mini.yaml", "--out", "run", cwd=folder)

    return make_once(tmp_path_factory, "mini", make) / "run"


@pytest.fixture(scope="session")
def finished_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of two cases, likewise; ``mine.yaml`` beside it is the study."""
    from tests.helpers.command import make_by_command
    from tests.helpers.small_study import write_study

    def make(folder: Path) -> None:
        make_by_command("study", str(write_study(folder)), "--out", "study", cwd=folder)

    return make_once(tmp_path_factory, "study", make) / "study"


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(ProcessorTime())
    config.pluginmanager.register(TimeLimit())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with the most slow tests first, so that no worker is left with a long one at the end."""
    slow: dict[Path, int] = {}
    for item in items:
        slow[item.path] = slow.get(item.path, 0) + (item.get_closest_marker("slow") is not None)
    items.sort(key=lambda item: -slow[item.path])
