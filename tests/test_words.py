"""Names and prose keep to plain technical words: ``words.txt`` lists those that are refused."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
CODE = [file for name in ("sim", "deepgps", "docs", "tests") for file in sorted((ROOT / name).rglob("*.py"))]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "how-to").glob("*.md"))]
UNIT = re.compile(r"_(M|M2|PX|RAD|DEG|S|NS|MPS|RPS|RADPS|MB|GB|BYTES|PER_M)$")


def read_words() -> tuple[set[str], re.Pattern]:
    """The names that are refused, and a pattern of the refused words of prose."""
    names, prose = (Path(__file__).parent / "words.txt").read_text(encoding="utf-8").split("\n\n")
    lines = [line.partition(":")[0] for line in prose.splitlines() if line.strip() and not line.startswith("#")]
    words = {word for line in names.splitlines() if not line.startswith("#") for word in line.split()}
    return words, re.compile(r"\b(" + "|".join(re.escape(line).replace(r"\ ", r"\s+") for line in lines) + r")\b", re.I)


def list_constants(tree: ast.Module) -> Iterator[ast.Name]:
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                yield from (name for name in ast.walk(target) if isinstance(name, ast.Name))


def list_prose(text: str, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """The comments and docstrings of a module, each with its line."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def test_names_and_prose_use_no_refused_word():
    names, prose = read_words()
    refused = [f"{page.relative_to(ROOT)}: {match[0]}" for page in PAGES for match in prose.finditer(page.read_text())]
    for file in CODE:
        text = file.read_text(encoding="utf-8")
        tree, place = ast.parse(text), file.relative_to(ROOT)
        refused += [
            f"{place}:{name.lineno}: {name.id}"
            for name in list_constants(tree)
            if name.id.isupper() and UNIT.sub("", name.id).strip("_") in names
        ]
        refused += [
            f"{place}:{line}: {match[0]}" for line, said in list_prose(text, tree) for match in prose.finditer(said)
        ]
    assert len(names) > 100 and not refused, "\n".join(refused)
