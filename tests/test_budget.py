"""What the project may weigh: a change that adds more takes as much away, or says why and raises the number."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST = {
    "lines of sim and deepgps": 46_400,
    "files of sim and deepgps": 335,
    "lines of tests": 29_300,
    "Python files directly in deepgps": 2,
}


def count_lines(files: list[Path]) -> int:
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


def test_the_project_stays_light():
    product = [file for package in ("sim", "deepgps") for file in (ROOT / package).rglob("*.py")]
    found = {
        "lines of sim and deepgps": count_lines(product),
        "files of sim and deepgps": len(product),
        "lines of tests": count_lines(list((ROOT / "tests").rglob("*.py"))),
        "Python files directly in deepgps": len(list((ROOT / "deepgps").glob("*.py"))),
    }
    over = [f"{name}: {found[name]:,}, at most {most:,}" for name, most in MOST.items() if found[name] > most]
    assert not over, "; ".join(over)
