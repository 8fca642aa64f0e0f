"""The examples run as they are, in a folder of the reader's, are short, and are plugins where they say so."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.pages import Block, check_code

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SAYS = {
    "scenario_and_error_field.py": ([], "error_field.png"),
    "position_one_image.py": ([], "knn: x "),
    "own_encoder_fault.py": ([], "growth 10%: segments wrong by "),
    "own_method.py": ([], "nearest_image: "),
    "own_controller.py": (["240"], "'knn': '"),
    "drive_to_a_goal.py": ([], "arrived: True"),
}
"""Arguments of each example that make it small, and something that it prints."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("examples")


def test_every_example_is_tried_and_short():
    examples = {path.name: path.read_text() for path in EXAMPLES.glob("*.py")}
    assert (
        len(examples.pop("deepgps_from_scratch.py").splitlines()) <= 300
    )  # a method; tests/test_from_scratch.py runs it
    assert set(examples) == set(SAYS)
    assert {name: len(text.splitlines()) for name, text in examples.items() if len(text.splitlines()) > 40} == {}


@pytest.mark.parametrize("name", SAYS)
def test_an_example_imports_what_there_is(name: str):
    check_code(Block(EXAMPLES / name, 1, "python", (EXAMPLES / name).read_text()))


@pytest.mark.slow
@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(name: str, folder: Path):
    words, said = SAYS[name]
    environment = {**os.environ, "MPLBACKEND": "agg", "PYTHONWARNINGS": "error"}
    command = [sys.executable, str(EXAMPLES / name), *words]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=500
    )
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
