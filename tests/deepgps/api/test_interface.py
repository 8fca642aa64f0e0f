"""The names of ``import deepgps``: quick to import, all there, all described."""

import ast
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import deepgps

HEAVY_PACKAGES = {"numpy", "torch", "mujoco", "rerun", "pydantic", "pyarrow", "matplotlib"}


def test_importing_takes_no_time_and_loads_nothing_heavy():
    code = (
        "import sys, time; start = time.process_time(); import deepgps; deepgps.__version__; "
        f"print(time.process_time() - start, *sorted({HEAVY_PACKAGES} & set(sys.modules)))"
    )
    seconds, *loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert loaded == []
    assert float(seconds) < 0.5


def test_every_name_can_be_taken_and_is_described_and_no_other():
    for name in set(deepgps.__all__) - {"__version__"}:
        value = getattr(deepgps, name)
        assert value.__name__ == name
        assert value.__doc__ and value.__doc__[0].isupper()
        assert name in dir(deepgps)
    assert deepgps.__version__ == version("deepgps")
    with pytest.raises(AttributeError, match="module 'deepgps' has no attribute 'lod'"):
        _ = deepgps.lod


def test_what_checkers_see_is_what_there_is():
    """The imports for type checkers name the same modules as the table that is used."""
    tree = ast.parse(Path(deepgps.__file__).read_text())
    seen = {
        name.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module not in {"importlib.metadata", "pkgutil", "typing"}
        for name in node.names
    }
    assert seen == deepgps._HOME
