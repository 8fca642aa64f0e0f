"""The parts of the documentation that come from the code: ``python -m docs.generate`` writes them into its pages.

Such a part stands between two comments, ``<!-- generated: settings -->`` and ``<!-- end -->``, so that a page reads in
the repository as on the site.
"""

import ast
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from inspect import cleandoc
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

from sphinx.pycode import ModuleAnalyzer

import deepgps
from deepgps.commands.main import COMMANDS, main
from deepgps.config.methods import METHODS
from deepgps.config.scenario import Scenario
from deepgps.robot_io.logs.robot_config import (
    CameraConfig,
    DriveConfig,
    Intrinsics,
    PoseConfig,
    RobotConfig,
    WheelConfig,
)
from deepgps.studies.catalog import REPORTS
from deepgps.studies.study import Study
from docs.read_code import list_entries
from sim.settings import Group

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MARK = "<!-- generated: "
GENERATED = [page for page in sorted([*DOCS.glob("*.md"), *DOCS.glob("*/*.md")]) if MARK in page.read_text("utf-8")]
"""Pages with such parts."""
Schema = Mapping[str, Any]
NAMES = {"methods": METHODS, "report": REPORTS}
"""Names that a setting allows, where the JSON schema of the settings does not tell them."""
ROBOT: Mapping[str, type[Group]] = {
    "": RobotConfig,
    "wheels": WheelConfig,
    "camera": CameraConfig,
    "camera.intrinsics": Intrinsics,
    "pose": PoseConfig,
    "drive": DriveConfig,
}
"""Groups of a robot's file; some may be missing in it."""
COLUMNS = 100
"""Width of the commands' help."""


def fill_in(text: str) -> str:
    """A page's text with its generated parts as the code is now."""
    parts = {
        "methods": describe_methods,
        "settings": describe_settings,
        "study": describe_study,
        "robot": describe_robot,
        "commands": describe_commands,
        "api": describe_api,
        "keys": describe_keys,
        "code": show_code,
        "tables": list_tables,
    }
    return re.sub(
        r"^(<!-- generated: (\w+)([^\n]*?) -->\n).*?(?=<!-- end -->)",
        lambda found: f"{found[1]}\n{parts[found[2]](*found[3].split())}\n\n",
        text,
        flags=re.MULTILINE | re.DOTALL,
    )


def show_figures(page: str) -> str:
    """The published figures of the study that a page reports."""
    figures = sorted((ROOT / "docs" / page).parent.glob("figures/*.png"))
    return "\n## Figures\n\n" + "".join(f"![{path.stem}](figures/{path.name})\n\n" for path in figures)


def describe_methods() -> str:
    """Tables of the methods, and of the baselines that they are compared with."""
    heads, rows = ("method", "title", "map by", "estimator", "observations"), {True: [], False: []}
    for name, one in METHODS.items():
        seen = f"`{one.observes}`" if one.observes else "any"
        rows[one.is_baseline].append((f"`{name}`", one.title, one.map, one.estimator, seen))
    return f"{_table(heads, rows[False])}\n\nBaselines:\n\n{_table(heads, rows[True])}"


def describe_settings() -> str:
    """Every setting of a scenario: a table for each group."""
    return _describe_groups(dict(list_groups(Scenario)))


def describe_study() -> str:
    """Every key of a study's file."""
    return _describe_groups({"": Study})


def describe_robot() -> str:
    """Every key of a robot's file: a table for each group."""
    return _describe_groups(ROBOT)


def describe_commands() -> str:
    """The help of the program and of each command, in a section each."""
    parts = [_code(read_help())]
    parts += [f"## `deepgps {command}`\n\n{_code(read_help(command))}" for command in COMMANDS]
    return "\n\n".join(parts)


def describe_api() -> str:
    """The package's public names in a list, and the directive by which Sphinx describes them in full."""
    names = sorted(name for name in deepgps.__all__ if not name.startswith("_"))
    rows = [(f"[`{name}`](#deepgps.{name})", _summarise(getattr(deepgps, name))) for name in names]
    full = _code(".. automodule:: deepgps\n   :members:", "{eval-rst}")
    return f"{_table(('name', 'what'), rows)}\n\n{full}"


def describe_keys(*names: str) -> str:
    """What definitions, ``module:Name`` or ``prefix=module:Name``, put into a file: a table of keys and meanings."""
    rows: dict[str, list[str]] = {}
    for name in names:
        prefix, _, definition = name.rpartition("=")
        for key, said in list_entries(definition):
            rows.setdefault(said, []).append(f"`{prefix}{key}`")
    return _table(("key", "what"), [(", ".join(keys), _markdown(said)) for said, keys in rows.items()])


def show_code(file: str, name: str = "") -> str:
    """A file of ``docs/examples``, or one of its functions."""
    path = DOCS / "examples" / file
    text = path.read_text(encoding="utf-8").rstrip()
    if name:
        node = next(one for one in ast.parse(text).body if getattr(one, "name", None) == name)
        text = str(ast.get_source_segment(text, node))
    return _code(text, {".py": "python"}.get(path.suffix, path.suffix[1:]))


def list_tables() -> str:
    """Links to the tables of all published studies."""
    return "\n".join(
        f"- [{one.parent.name}]({one.relative_to(DOCS)})" for one in sorted(DOCS.glob("results/*/table.md"))
    )


def list_groups(group: type[Group], name: str = "") -> Iterator[tuple[str, type[Group]]]:
    """A group of settings and all groups inside it, with their dotted names."""
    yield name, group
    for key, field in group.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Group):
            yield from list_groups(field.annotation, f"{name}.{key}".lstrip("."))


def read_help(*command: str) -> str:
    """What ``deepgps COMMAND --help`` prints, without colours."""
    said = StringIO()
    with patch.dict(os.environ, COLUMNS=str(COLUMNS), NO_COLOR="1"), redirect_stdout(said), suppress(SystemExit):
        main([*command, "--help"])
    return "\n".join(line.rstrip() for line in said.getvalue().strip().splitlines())


def _describe_groups(groups: Mapping[str, type[Group]]) -> str:
    parts = []
    for name, group in groups.items():
        if name:
            parts.append(f"## `{name}`\n\n{_markdown(cleandoc(group.__doc__ or ''))}")
        if rows := list(_describe_fields(group, f"{name}." if name else "")):
            parts.append(_table(("name", "default; allowed", "what"), rows))
    return "\n\n".join(parts)


def _describe_fields(group: type[Group], prefix: str) -> Iterator[tuple[str, ...]]:
    documented = _read_docstrings(group)
    schema = group.model_json_schema()
    for key, field in group.model_fields.items():
        details = schema["properties"][key]
        choices = [details, *details.get("anyOf", [])]
        if any("$ref" in one for one in choices) and group is not Study:  # a group, which has a section of its own
            continue
        default = (
            "it must be given" if field.is_required() else f"`{_as_yaml(field.get_default(call_default_factory=True))}`"
        )
        yield f"`{prefix}{key}`", f"{default}; {_name_type(key, details)}", _markdown(documented[key])


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in [headings, ["---"] * len(headings), *rows])


def _summarise(thing: object) -> str:
    """First sentence of a docstring."""
    text = " ".join(cleandoc(thing.__doc__ or "").partition("\n\n")[0].split())
    return _markdown(re.split(r"(?<=\.) (?=[A-Z])", text)[0])


def _name_type(key: str, schema: Schema) -> str:
    """The type of a setting and what is allowed, from its JSON schema."""
    kind = schema.get("type")
    if "anyOf" in schema:
        return " or ".join(_name_type(key, one) for one in schema["anyOf"])
    if "const" in schema:
        schema = {**schema, "enum": [schema["const"]]}
    if names := schema.get("enum") or (kind == "string" and NAMES.get(key)):
        return "one of " + ", ".join(f"`{name}`" for name in names)
    if "$ref" in schema:
        return "mapping"
    if kind == "array":
        return f"list, each {_name_type(key, schema.get('items', {}))}"
    if kind in {"integer", "number"}:
        return ", ".join([kind, *_name_limits(schema)])
    names = {"string": "text", "boolean": "`true` or `false`", "null": "`null`", "object": "mapping"}
    return names.get(kind or "", "value")


def _name_limits(schema: Schema) -> list[str]:
    if {"minimum", "maximum"} <= set(schema):
        return [f"{_number(schema['minimum'])} to {_number(schema['maximum'])}"]
    words = {"minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most"}
    return [f"{word} {_number(schema[limit])}" for limit, word in words.items() if limit in schema]


def _number(value: float) -> str:
    if value == 2**63 - 1:
        return "2⁶³ - 1"
    return f"{int(value):,}" if value == int(value) else f"{value:g}"


def _as_yaml(value: Any) -> str:
    if isinstance(value, Group):
        return "{}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_as_yaml, value))}]"
    return (
        {None: "null", True: "true", False: "false"}[value] if value is None or isinstance(value, bool) else str(value)
    )


def _read_docstrings(group: type[Group]) -> dict[str, str]:
    """The text below each field of a group, those of inherited fields included."""
    found: dict[str, str] = {}
    for kind in reversed(group.__mro__):
        if kind.__module__.partition(".")[0] in {"sim", "deepgps"}:
            attributes = ModuleAnalyzer.for_module(kind.__module__).find_attr_docs()
            found |= {
                key: " ".join(lines).strip() for (owner, key), lines in attributes.items() if owner == kind.__name__
            }
    return found


def _markdown(text: str) -> str:
    """A docstring's text as Markdown: its own characters are not markup, and None is YAML's null."""
    parts = re.sub(r"\bNone\b", "``null``", text).replace("``", "`").split("`")
    parts[::2] = (re.sub(r"[*<|\[\]$]|(?<!\w)_|_(?!\w)", r"\\\g<0>", part) for part in parts[::2])
    return "`".join(part.replace("|", r"\|") if number % 2 else part for number, part in enumerate(parts))


def _code(text: str, language: str = "text") -> str:
    return f"```{language}\n{text}\n```"


if __name__ == "__main__":
    for page in GENERATED:
        page.write_text(fill_in(page.read_text(encoding="utf-8")), encoding="utf-8")
