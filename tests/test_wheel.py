"""The wheel alone is enough: robot and scenarios travel in it, and the chain runs from any folder."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built as a release would be, from the files of this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    call(sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder), cwd=ROOT)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The wheel, installed without its dependencies into a folder of its own."""
    folder = tmp_path_factory.mktemp("installed")
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder))
    call(*pip, str(wheel), cwd=folder)
    return folder


def call(*command: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_wheel_holds_every_asset_and_no_test(wheel):
    held = set(zipfile.ZipFile(wheel).namelist())
    assets = {path.relative_to(ROOT).as_posix() for path in (ROOT / "assets").rglob("*") if path.is_file()}
    assert "assets/robot/robot.xml" in assets
    assert {f"sim/{asset}" for asset in assets} <= held
    folders = {name.split("/")[0] for name in held if ".dist-info/" not in name}
    assert folders == {"sim", "deepgps"}


SMALL = ("--drive.samples", "120", "--learn.train.steps", "20", "--methods", "deepgps")


@pytest.mark.slow
def test_tiny_scenario_runs_from_the_wheel_in_another_folder(installed, tmp_path):
    # the wheel's folder comes first on the path, before the checkout that is installed beside it
    where = call(
        sys.executable, "-c", "import sim, deepgps; print(sim.__file__, deepgps.__file__)",
        cwd=tmp_path, PYTHONPATH=str(installed),
    )  # fmt: skip
    assert where.count(str(installed)) == 2
    call(str(installed / "bin" / "deepgps"), "run", "tiny", *SMALL, cwd=tmp_path, PYTHONPATH=str(installed))
    (metrics,) = (tmp_path / "runs" / "tiny").glob("*/metrics.json")
    assert json.loads(metrics.read_text(encoding="utf-8"))["methods"]["deepgps"]["rms_m"] > 0
