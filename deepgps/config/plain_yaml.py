"""YAML with nothing but plain values, each written once; a violation is one line."""

from pathlib import Path
from typing import Any

import yaml

from sim.errors import InputError, quote, read_file, shorten

MAX_FILE_BYTES = 200_000  # bytes; a scenario has a few hundred
_TAG = "tag:yaml.org,2002:"
_PLAIN_TAGS = {_TAG + name for name in ("null", "bool", "int", "float", "str", "seq", "map")}


class _Loader(yaml.SafeLoader):
    """Refuses aliases, which a small file can repeat until it fills the memory, tags, and keys that are given twice."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="aliases are not allowed", problem_mark=event.start_mark)
        node = super().compose_node(parent, index)
        if node is not None and node.tag not in _PLAIN_TAGS:
            what = quote(node.value) if isinstance(node, yaml.ScalarNode) else f"a {node.id}"
            problem = f"{what} is of type {node.tag.removeprefix(_TAG)}; put quotes around what is text"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key, problem = self.construct_object(key_node), None
            if not isinstance(key, str):
                problem = f"the key {quote(key)} must be text"
            elif key in seen:  # YAML would silently keep the last
                problem = f"{shorten(key)} is given twice"
            if problem:
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping of plain values; raises InputError, which names the file, the line and the problem."""
    what = shorten(str(path), 300)
    data = read_file(path, MAX_FILE_BYTES, f"{what}: a settings file")
    try:
        values = yaml.load(data.decode("utf-8"), _Loader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise InputError(f"{what}: {line}{shorten(str(error.problem), 200)}") from None
    except RecursionError:
        raise InputError(f"{what}: its values are nested too deeply") from None
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
        raise InputError(f"{what}: {shorten(str(error).partition(chr(10))[0], 300)}") from None
    if not isinstance(values, dict):
        kind = "is empty" if values is None else f"holds a {type(values).__name__}"
        raise InputError(f"{what} {kind}; a settings file is a mapping, such as 'seed: 0'")
    return values
