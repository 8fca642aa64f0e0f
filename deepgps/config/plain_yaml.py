"""YAML with nothing but plain values: limits are checked before a value is made, and a violation is one line.

The parser's events are counted first, without keeping any, so that depth and number are known before memory is spent.
Then the graph of nodes is checked, and only a plain graph becomes values.
"""

from pathlib import Path
from typing import Any

import yaml

from sim.errors import InputError
from sim.user_input import quote, read_file, shorten

LARGEST_FILE = 1_000_000  # bytes; a scenario has a few hundred
DEEPEST = 32
MOST_VALUES = 120_000
LONGEST_NUMBER = 100
LARGEST_TEXT = 4 * LARGEST_FILE  # characters, with aliases written out
_TAG = "tag:yaml.org,2002:"
_PLAIN = {_TAG + name for name in ("null", "bool", "int", "float", "str", "seq", "map")}
_TEXT = _TAG + "str"
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # many times faster, where PyYAML has libyaml
_RAISED_BY_VALUES = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)


def read_yaml(path: Path, most_values: int = MOST_VALUES) -> dict[str, Any]:
    """Read a YAML mapping of plain values.

    Args:
        path: The file.
        most_values: Keys and values that the file may hold, counting those that aliases repeat each time.

    Raises:
        InputError: The file is not such a mapping; the message names the file, the line and the problem.
    """
    what = shorten(str(path), 300)
    data = read_file(path, LARGEST_FILE, f"{what}: a settings file")
    try:
        values = _read(data.decode("utf-8"), most_values)
    except (yaml.YAMLError, UnicodeDecodeError, _Refusal) as error:
        raise InputError(f"{what}: {_first_problem(error)}") from None
    if values is None:
        raise InputError(f"{what} is empty; a settings file is a mapping, such as 'seed: 0'")
    if not isinstance(values, dict):
        raise InputError(f"{what} holds a {type(values).__name__}; a settings file is a mapping, such as 'seed: 0'")
    return values


class _Refusal(Exception):
    """A violation: what a file must not hold, and the line that holds it."""

    def __init__(self, node: yaml.Node | yaml.Event, problem: str) -> None:
        super().__init__(f"line {node.start_mark.line + 1}: {problem}")


class _Values(_Loader):
    """Loader that names the line of a value that does not suit its tag, whatever Python raises for it."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except _RAISED_BY_VALUES as error:
            raise _Refusal(node, f"{_show(node)} is no {node.tag.removeprefix(_TAG)} ({shorten(str(error))})") from None


def _read(text: str, most_values: int) -> Any:
    _count_events(text, most_values)
    loader = _Values(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _judge(node, most_values)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _count_events(text: str, most_values: int) -> None:
    """Refuse too many levels, too many values and unknown tags before any of them is kept."""
    depth = values = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if not isinstance(event, yaml.NodeEvent):
            continue
        values += 1
        if values > most_values:
            raise _Refusal(event, f"more than {most_values} values in one file")
        if getattr(event, "tag", None) not in {None, "!", *_PLAIN}:
            raise _Refusal(event, f"the tag {quote(event.tag)} is not allowed; write a number or text as it is")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > DEEPEST:
                raise _Refusal(event, f"more than {DEEPEST} levels, one in the other")


def _judge(root: yaml.Node, most_values: int) -> None:
    """Refuse nodes that are not plain, keys that are not text or repeated, and aliases that expand too far."""
    sizes: dict[int, tuple[int, int] | None] = {}

    def measure(node: yaml.Node) -> tuple[int, int]:
        if id(node) in sizes:
            size = sizes[id(node)]
            if size is None:
                raise _Refusal(node, "an alias leads back to itself")
            return size
        sizes[id(node)] = None
        _judge_one(node)
        parts = node.value if isinstance(node, yaml.CollectionNode) else []
        if isinstance(node, yaml.MappingNode):
            parts = [part for pair in node.value for part in pair]
        count, letters = 1, 0 if parts else len(node.value)
        for part in parts:
            more = measure(part)
            count, letters = count + more[0], letters + more[1]
        if count > most_values or letters > LARGEST_TEXT:
            raise _Refusal(node, f"aliases repeat more than {most_values} values or {LARGEST_TEXT} characters")
        sizes[id(node)] = count, letters
        return count, letters

    measure(root)


def _judge_one(node: yaml.Node) -> None:
    if node.tag not in _PLAIN:
        kind = node.tag.removeprefix(_TAG)
        raise _Refusal(node, f"{_show(node)} is read as {kind}; put quotes around what is text")
    if isinstance(node, yaml.MappingNode):
        _judge_keys(node)
    elif isinstance(node, yaml.ScalarNode) and node.tag == _TEXT:
        if not node.value.isascii() and node.value.encode(errors="replace").decode() != node.value:
            raise _Refusal(node, f"{_show(node)} has half of a character in it")
    elif isinstance(node, yaml.ScalarNode) and len(node.value) > LONGEST_NUMBER:
        raise _Refusal(node, f"{_show(node)} is longer than {LONGEST_NUMBER} characters")


def _judge_keys(node: yaml.MappingNode) -> None:
    seen = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag != _TEXT:
            raise _Refusal(key, f"the key {_show(key)} must be text")
        if key.value in seen:  # YAML would silently keep the last
            raise _Refusal(key, f"{shorten(key.value)} is given twice")
        seen.add(key.value)


def _show(node: yaml.Node) -> str:
    return quote(node.value) if isinstance(node, yaml.ScalarNode) else f"a {node.id}"


def _first_problem(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: {shorten(str(error.problem), 200)}"
    return shorten(str(error).partition("\n")[0], 300)
