"""What the project may weigh: a change that adds more takes as much away, or says why and raises the number."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMITS = {
    "lines of sim and deepgps": 41_115,
    "files of sim and deepgps": 299,
    "lines of tests": 28_878,
    "Python files directly in deepgps": 2,
    "words of decisions": 6_879,
    "words of all other pages by hand": 21_283,
    "words of the reference that the code does not say": 3_334,
    "words of published results": 8_000,
}


def count_lines(files: list[Path]) -> int:
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


def count_words(files: list[Path]) -> int:
    return sum(len(drop_generated(file.read_text(encoding="utf-8")).split()) for file in files)


def drop_generated(text: str) -> str:
    return re.sub(r"^<!-- generated: .*?^<!-- end -->", "", text, flags=re.MULTILINE | re.DOTALL)


def test_the_project_stays_light():
    product = [file for package in ("sim", "deepgps") for file in (ROOT / package).rglob("*.py")]
    docs, decisions = ROOT / "docs", ROOT / "docs" / "decisions.md"
    pages = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "runs/README.md")]
    pages += [*docs.glob("*.md"), *(docs / "how-to").glob("*.md")]
    found = {
        "lines of sim and deepgps": count_lines(product),
        "files of sim and deepgps": len(product),
        "lines of tests": count_lines(list((ROOT / "tests").rglob("*.py"))),
        "Python files directly in deepgps": len(list((ROOT / "deepgps").glob("*.py"))),
        "words of decisions": count_words([decisions]),
        "words of all other pages by hand": count_words([page for page in pages if page != decisions]),
        "words of the reference that the code does not say": count_words(list((docs / "reference").glob("*.md"))),
        "words of published results": count_words(list((docs / "results").rglob("*.md"))),
    }
    over = [f"{name}: {found[name]:,}, at most {most:,}" for name, most in LIMITS.items() if found[name] > most]
    assert not over, "; ".join(over)
