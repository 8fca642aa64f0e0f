"""The wheel alone is enough: robot and scenarios are in it, and the command runs from any folder."""

import json
import os
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_string
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def dist(tmp_path_factory) -> Path:
    """A folder with the wheel and the source archive, built as ``make dist`` builds them, from this checkout."""
    folder = tmp_path_factory.mktemp("dist")
    build(ROOT, folder)
    return folder


@pytest.fixture(scope="module")
def wheel(dist) -> Path:
    (built,) = dist.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The wheel, installed without its dependencies into a folder of its own."""
    folder = tmp_path_factory.mktemp("installed")
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder))
    call(*pip, str(wheel), cwd=folder)
    return folder


def build(source: Path, folder: Path) -> None:
    call(sys.executable, "-m", "hatchling", "build", "--directory", str(folder), cwd=source)


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


def test_source_archive_builds_the_same_wheel(dist, wheel, tmp_path):
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    build(source, tmp_path / "dist")
    (again,) = (tmp_path / "dist").glob("*.whl")
    assert again.read_bytes() == wheel.read_bytes()


def test_metadata_tells_what_an_index_shows(wheel):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    held = zipfile.ZipFile(wheel)
    info = f"deepgps-{project['version']}.dist-info"
    metadata = message_from_string(held.read(f"{info}/METADATA").decode())
    assert metadata["License-Expression"] == "Apache-2.0"
    assert held.read(f"{info}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload() == (ROOT / "README.md").read_text(encoding="utf-8")
    pythons = SpecifierSet(metadata["Requires-Python"])
    named = [line.rpartition(" ")[2] for line in metadata.get_all("Classifier", []) if "Python :: 3." in line]
    assert named == [f"3.{minor}" for minor in range(30) if f"3.{minor}" in pythons]


def test_installed_command_finds_its_assets_from_another_folder(installed, tmp_path):
    program = str(installed / "bin" / "deepgps")
    assert "doctor" in call(program, "--help", cwd=tmp_path, PYTHONPATH=str(installed))
    listing = "import sim.files as p; print(p.__file__, *p.SCENARIOS.iterdir(), *p.STUDIES.iterdir(), sep='\\n')"
    where, *found = call(sys.executable, "-c", listing, cwd=tmp_path, PYTHONPATH=str(installed)).splitlines()
    assert where == str(installed / "sim" / "files" / "__init__.py")
    here = [*(ROOT / "assets" / "scenarios").iterdir(), *(ROOT / "assets" / "studies").iterdir()]
    assert {Path(path) for path in found} == {installed / "sim" / path.relative_to(ROOT) for path in here}


SMALL_RUN = ("--drive.samples", "120", "--learn.train.steps", "20", "--methods", "deepgps")


@pytest.mark.slow
def test_tiny_scenario_runs_from_the_wheel_in_another_folder(installed, tmp_path):
    # the wheel's folder comes first on the path, before the checkout that is installed beside it
    where = call(
        sys.executable, "-c", "import sim, deepgps; print(sim.__file__, deepgps.__file__)",
        cwd=tmp_path, PYTHONPATH=str(installed),
    )  # fmt: skip
    assert where.count(str(installed)) == 2
    call(str(installed / "bin" / "deepgps"), "run", "tiny", *SMALL_RUN, cwd=tmp_path, PYTHONPATH=str(installed))
    (metrics,) = (tmp_path / "runs" / "tiny").glob("*/metrics.json")
    assert json.loads(metrics.read_text(encoding="utf-8"))["methods"]["deepgps"]["rms_m"] > 0
