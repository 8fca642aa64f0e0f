"""What files hold, from the code that writes them: fields of classes and keys of dictionaries, with their comments."""

import ast
import re
from collections.abc import Iterator
from inspect import cleandoc
from io import StringIO
from pathlib import Path
from pkgutil import resolve_name
from sys import modules
from tokenize import COMMENT, generate_tokens

Definition = ast.ClassDef | ast.FunctionDef
NAME = re.compile(r"[a-z][a-z0-9_]*")


class Source:
    """A module's definitions, and the comment beside or above each line."""

    def __init__(self, module: str) -> None:
        resolve_name(module)
        text = Path(str(modules[module].__file__)).read_text(encoding="utf-8")
        self.lines, self.tree = text.splitlines(), ast.parse(text)
        self.comments = {
            token.start[0]: token.string.lstrip("# ")
            for token in generate_tokens(StringIO(text).readline)
            if token.type == COMMENT and not token.string.startswith(("# noqa", "# type"))
        }

    def find(self, name: str) -> Definition:
        """The class or function of a name."""
        for node in self.tree.body:
            if isinstance(node, Definition) and node.name == name:
                return node
        raise KeyError(name)

    def explain(self, node: ast.AST) -> str:
        """The comment beside a node's first or last line, or that above it."""
        first, last = node.lineno, node.end_lineno or node.lineno  # pyright: ignore[reportAttributeAccessIssue]
        for line in (last, first):
            if line in self.comments:
                return self.comments[line]
        above = []
        while (first := first - 1) in self.comments and self.lines[first - 1].lstrip().startswith("#"):
            above.insert(0, self.comments[first])
        return " ".join(above)

    def list_fields(self, node: ast.ClassDef) -> Iterator[tuple[str, str]]:
        """Fields of a class, each with what is said of it."""
        for one in node.body:
            if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name):
                alias = re.search(r"alias='(\w+)'", ast.unparse(one))
                yield (alias[1] if alias else one.target.id), self.explain(one)

    def list_keys(self, node: ast.AST, prefix: str = "") -> Iterator[tuple[str, str]]:
        """Keys of the dictionaries in a function, nested ones dotted, each with what is said of it."""
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(key, ast.Constant) and NAME.fullmatch(str(key.value)):
                    inner = list(self.list_keys(value, f"{prefix}{key.value}."))
                    said = self.comments.get(key.lineno, "") or self.explain(key)
                    if said or not inner:
                        yield f"{prefix}{key.value}", said
                    yield from inner
                elif key is None:
                    yield from self.list_keys(value, prefix)
        else:
            for child in ast.iter_child_nodes(node):
                if isinstance(node, ast.Assign) and isinstance(child, ast.Subscript):
                    if isinstance(child.slice, ast.Constant) and NAME.fullmatch(str(child.slice.value)):
                        yield f"{prefix}{child.slice.value}", self.explain(node)
                else:
                    yield from self.list_keys(child, prefix)


def list_entries(name: str) -> list[tuple[str, str]]:
    """What a definition, ``module:Name``, puts into a file: pairs of a key and its meaning.

    Keys that have no comment share a row, with the first sentence of the function's docstring.
    """
    module, _, inner = name.partition(":")
    source = Source(module)
    node = source.find(inner)
    if isinstance(node, ast.ClassDef):
        return list(source.list_fields(node))
    found = dict.fromkeys(source.list_keys(node))
    summary = read_summary(node)
    return [entry if entry[1] else (entry[0], summary) for entry in found]


def read_summary(node: Definition) -> str:
    """First sentence of a docstring."""
    text = cleandoc(ast.get_docstring(node) or "").partition("\n\n")[0]
    return " ".join(text.split())
