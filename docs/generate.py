"""The parts of the documentation that come from the code: settings, commands and the Python API.

A page has a comment in the place of such a part, ``<!-- generated: settings -->``, and on the same line what readers of
the repository see instead.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from inspect import cleandoc
from pathlib import Path
from typing import Any

from sphinx.pycode import ModuleAnalyzer

import deepgps
from deepgps.commands.main import COMMANDS
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
from sim.settings import Group

ROOT = Path(__file__).parents[1]
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
IN_MODULES = {
    "deepgps.viewer.read": ("read_error_table", "read_error_field", "read_entity"),
    "deepgps.config.scenario": ("load_scenario",),
    "sim.recording.format": ("open_recording", "Recording", "open_truth", "Truth"),
}
"""What the page of the Python API describes while the package itself names nothing."""


def fill_in(text: str, page: str = "") -> str:
    """A page's text with its generated parts and a study's figures; "RMS / median / max" stays on one line."""
    text += show_figures(page) if page.startswith("results/") else ""
    text = re.sub(r"(?<=\d) / (?=\d)", "\u00a0/\u00a0", text)
    parts = {
        "settings": describe_settings,
        "study": describe_study,
        "robot": describe_robot,
        "commands": describe_commands,
        "api": describe_api,
    }
    return re.sub(r"^<!-- generated: (\w+) -->.*$", lambda found: parts[found[1]](), text, flags=re.MULTILINE)


def show_figures(page: str) -> str:
    """The published figures of the study that a page reports."""
    figures = sorted((ROOT / "docs" / page).parent.glob("figures/*.png"))
    return "\n## Figures\n\n" + "".join(f"![{path.stem}](figures/{path.name})\n\n" for path in figures)


def describe_settings() -> str:
    """Every setting of a scenario: a section for each group."""
    parts = []
    for name, group in list_groups(Scenario):
        if name:
            parts.append(f"## `{name}`\n\n{_markdown(cleandoc(group.__doc__ or ''))}\n")
        parts += _describe_fields(group, f"{name}." if name else "")
    return "\n".join(parts)


def describe_study() -> str:
    """Every key of a study's file."""
    return "\n".join(_describe_fields(Study, "", "study."))


def describe_robot() -> str:
    """Every key of a robot's file: a section for each group."""
    parts = []
    for name, group in ROBOT.items():
        if name:
            parts.append(f"## `{name}`\n\n{_markdown(cleandoc(group.__doc__ or ''))}\n")
        parts += _describe_fields(group, f"{name}." if name else "", "robot.")
    return "\n".join(parts)


def describe_commands() -> str:
    """The help of the program and of each command, in a section each."""
    parts = [_code(read_help())]
    parts += [f"## `deepgps {command}`\n\n{_code(read_help(command))}" for command in COMMANDS]
    return "\n\n".join(parts)


def describe_api() -> str:
    """Directives that describe the package's public objects."""
    if hasattr(deepgps, "__all__"):
        return _code(".. automodule:: deepgps\n   :members:", "{eval-rst}")
    return "\n\n".join(
        _code(f".. automodule:: {module}\n   :no-index:\n   :members: {', '.join(names)}", "{eval-rst}")
        for module, names in IN_MODULES.items()
    )


def list_groups(group: type[Group], name: str = "") -> Iterator[tuple[str, type[Group]]]:
    """A group of settings and all groups inside it, with their dotted names."""
    yield name, group
    for key, field in group.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Group):
            yield from list_groups(field.annotation, f"{name}.{key}".lstrip("."))


def read_help(*command: str) -> str:
    """What ``deepgps COMMAND --help`` prints, without colours.

    In a process of its own, since Sphinx imports modules as a type checker does, after which tyro cannot read them.
    """
    words = [sys.executable, "-m", "deepgps.commands.main", *command, "--help"]
    environment = {**os.environ, "COLUMNS": str(COLUMNS), "NO_COLOR": "1", "PYTHONPATH": str(ROOT)}
    said = subprocess.run(words, env=environment, check=True, capture_output=True, text=True).stdout
    return "\n".join(line.rstrip() for line in said.strip().splitlines())


def _describe_fields(group: type[Group], prefix: str, label: str = "") -> Iterator[str]:
    documented = _read_docstrings(group)
    schema = group.model_json_schema()
    for key, field in group.model_fields.items():
        details = schema["properties"][key]
        choices = [details, *details.get("anyOf", [])]
        if any("$ref" in one for one in choices) and group is not Study:  # a group, which has a section of its own
            continue
        default = (
            "none, it must be given"
            if field.is_required()
            else f"`{_as_yaml(field.get_default(call_default_factory=True))}`"
        )
        yield (
            f"````{{confval}} {label}{prefix}{key}\n:type: {_name_type(key, details)}\n:default: {default}\n\n"
            f"{_markdown(documented[key])}\n````\n"
        )


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
    text = re.sub(r"\bNone\b", "``null``", text)
    return re.sub(r"(?<!`)([*_<|\[\]$])", r"\\\1", text.replace("``", "`"))


def _code(text: str, language: str = "text") -> str:
    return f"````{language}\n{text}\n````"
