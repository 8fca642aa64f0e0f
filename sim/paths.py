"""Where the assets lie: inside the package when installed from a wheel, beside it in a checkout."""

from pathlib import Path

_HERE = Path(__file__).resolve().parent

ASSETS = _HERE / "assets" if (_HERE / "assets").is_dir() else _HERE.parent / "assets"
ROBOT = ASSETS / "robot"
SCENARIOS = ASSETS / "scenarios"
STUDIES = ASSETS / "studies"
