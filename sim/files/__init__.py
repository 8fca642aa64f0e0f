"""Files that are complete or absent, in which any changed bit is noticed; and where the assets are.

The assets are inside the package when it is installed from a wheel, and next to it in a checkout.
"""

from pathlib import Path

_SIM = Path(__file__).resolve().parents[1]
ASSETS = _SIM / "assets" if (_SIM / "assets").is_dir() else _SIM.parent / "assets"
ROBOT = ASSETS / "robot"
SCENARIOS = ASSETS / "scenarios"
STUDIES = ASSETS / "studies"
