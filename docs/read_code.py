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
Entry = tuple[str, str]
"""A key, and what is said of it."""


class Source:
    """A module's definitions, and the comment beside or above each line."""

    def __init__(self, module: str) -> None:
        resolve_name(module)
        text = Path(str(modules[module].__file__)).read_text(encoding="utf-8")
        self.lines, self.tree = text.splitlines(), ast.parse(text)
        self.comments = {
            token.start[0]: token.string.lstrip("# ")
            for token in generate_tokens(StringIO(text).readline)
            if token.type == COMMENT and not token.string.startswith(("# noqa", "# type", "# pyright"))
        }

    def find(self, name: str) -> Definition:
        """The class, function or ``Class.method`` of a name."""
        node: ast.Module | Definition = self.tree
        for part in name.split("."):
            node = next(one for one in node.body if isinstance(one, Definition) and one.name == part)
        assert isinstance(node, Definition)
        return node

    def explain(self, first: int, last: int) -> str:
        """The comment beside the last or the first of some lines, or that above them."""
        for line in (last, first):
            if line in self.comments:
                return self.comments[line]
        above = []
        while (first := first - 1) in self.comments and self.lines[first - 1].lstrip().startswith("#"):
            above.insert(0, self.comments[first])
        return " ".join(above)

    def list_fields(self, node: ast.ClassDef) -> Iterator[Entry]:
        """Fields of a class."""
        for one in node.body:
            if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name):
                alias = re.search(r"alias='(\w+)'", ast.unparse(one))
                yield (alias[1] if alias else one.target.id), self.explain(one.lineno, one.end_lineno or one.lineno)

    def list_keys(self, node: ast.AST, prefix: str = "") -> Iterator[Entry]:
        """Keys of the dictionaries in a function, nested ones dotted."""
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if key is None:
                    yield from self.list_keys(value, prefix)
                elif isinstance(key, ast.Constant) and NAME.fullmatch(str(key.value)):
                    yield from self._list_entry(f"{prefix}{key.value}", key, value)
        elif isinstance(node, ast.Assign) and isinstance(target := node.targets[0], ast.Subscript):
            outer = target.value if isinstance(target.slice, ast.Constant) else target
            if isinstance(outer, ast.Subscript):  # an entry of its own for each name
                prefix = f"{ast.unparse(outer.value)}.<name>."
            if isinstance(target.slice, ast.Constant):
                yield from self._list_entry(f"{prefix}{target.slice.value}", node, node.value)
            else:
                yield from self.list_keys(node.value, prefix)
        else:
            for child in ast.iter_child_nodes(node):
                yield from self.list_keys(child, prefix)

    def _list_entry(self, name: str, key: ast.expr | ast.stmt, value: ast.expr) -> Iterator[Entry]:
        inner = list(self.list_keys(value, f"{name}."))
        said = self.explain(key.lineno, key.lineno if inner else value.end_lineno or key.lineno)
        if said or not inner:
            yield name, said
        yield from ((part, more or said) for part, more in inner)


def list_entries(name: str) -> list[Entry]:
    """What a definition, ``module:Name``, puts into a file; the first sentence of a docstring explains keys without
    a comment."""
    module, _, inner = name.partition(":")
    source = Source(module)
    node = source.find(inner)
    if isinstance(node, ast.ClassDef):
        return list(source.list_fields(node))
    text = " ".join(cleandoc(ast.get_docstring(node) or "").partition("\n\n")[0].split())
    summary, found = re.split(r"(?<=\.) (?=[A-Z])", text)[0].removesuffix("."), dict[str, str]()
    for key, said in source.list_keys(node):
        found[key] = found.get(key) or said
    return [(key, said or summary) for key, said in found.items()]
