"""Locations of the assets: inside the package when installed from a wheel, next to it in a checkout."""

from pathlib import Path

_HERE = Path(__file__).resolve().parent

ASSETS = _HERE / "assets" if (_HERE / "assets").is_dir() else _HERE.parent / "assets"
ROBOT = ASSETS / "robot"
SCENARIOS = ASSETS / "scenarios"
STUDIES = ASSETS / "studies"
