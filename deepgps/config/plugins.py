"""Plugins: methods and encoder faults from outside, in a file or in an installed package.

A plugin is a Python module with a table ``METHODS`` of ``deepgps.Method``, a table ``ENCODER_FAULTS`` of
``deepgps.EncoderFault``, or both. An installed package offers one as an entry point of the group ``deepgps.plugins``.
"""

import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from deepgps.config.methods import METHODS, Method
from deepgps.config.scenario import Scenario
from sim import renamed
from sim.errors import InputError, WorkError, one_line
from sim.plugins import ENCODER_FAULTS, HOW_TO_LOAD, EncoderFault, Source, describe_failure
from sim.settings import EncoderSettings
from sim.user_input import quote, read_file, shorten

GROUP = "deepgps.plugins"
NAME = re.compile(r"[a-z][a-z0-9_]{0,40}")
TAKEN = {"features", "recording", "figures", "pairs", "truth", "heading", *renamed.METHODS}
"""Names that no method can have: folders of a run, and arrays of an error field."""
LARGEST = 10 * 1024 * 1024


def load_plugins(files: Iterable[str | Path] = ()) -> None:
    """Load the installed plugins and those in these files; a file that has changed since is loaded again.

    This is the only function that adds to ``METHODS`` and ``ENCODER_FAULTS``. Call it before scenarios are read.

    Raises:
        InputError: A file cannot be read, is no plugin, or defines a name that is taken.
        WorkError: A plugin's code raises an exception; the message names its file and line.
    """
    for point in entry_points(group=GROUP):
        _add(*_import_installed(point))
    for file in files:
        _add(*_import_file(Path(file).absolute()))


def list_files() -> list[Path]:
    """The files that are loaded as plugins, for other processes to load them too; they find installed ones."""
    sources = {record.source for table in (METHODS, ENCODER_FAULTS) for record in table.values() if record.source}
    return sorted(source.file for source in sources if not source.installed)


def check_plugins(scenario: Scenario) -> None:
    """Raise InputError if a plugin that a scenario needs is not loaded, or its source is not the scenario's."""
    wanted = {
        **{f"method {name}": (METHODS.get(name), source.sha256) for name, source in scenario.plugins.items()},
        **{
            f"encoder.plugins.{name}": (ENCODER_FAULTS.get(name), setting.sha256)
            for name, setting in scenario.encoder.plugins.items()
        },
    }
    for name, (found, checksum) in wanted.items():
        if found is None or found.source is None:
            raise InputError(f"{name}: no plugin that is loaded defines it; {HOW_TO_LOAD}")
        if found.source.sha256 != checksum:
            raise InputError(
                f"{name}: the source of its plugin, {found.source.file}, has changed since (sha256 "
                f"{found.source.sha256[:8]}, was {checksum[:8]}); choose another folder"
            )


def _import_file(path: Path) -> tuple[ModuleType, Source]:
    code = read_file(path, LARGEST, f"plugin {shorten(str(path), 300)}")
    source = Source(path, hashlib.sha256(code).hexdigest())
    name = f"deepgps_plugin_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    known = sys.modules.get(name)
    if known is not None and getattr(known, "__deepgps_source__", None) == source:
        return known, source
    if (spec := importlib.util.spec_from_file_location(name, path)) is None:
        raise InputError(f"plugin {shorten(str(path), 300)}: a plugin is a Python file, whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    module.__dict__["__deepgps_source__"] = source
    sys.modules[name] = module  # as pickle and dataclasses require
    try:
        exec(compile(code, str(path), "exec"), module.__dict__)  # the bytes of the checksum
    except (InputError, WorkError):
        del sys.modules[name]
        raise
    except Exception as error:
        del sys.modules[name]
        raise WorkError(describe_failure(error, path)) from error
    return module, source


def _import_installed(point: EntryPoint) -> tuple[ModuleType, Source]:
    try:
        module = point.load()
    except Exception as error:
        raise WorkError(f"plugin {point.name} ({point.value}): {type(error).__name__}: {one_line(error)}") from error
    file = getattr(module, "__file__", None)
    if not isinstance(module, ModuleType) or file is None:
        raise InputError(f"plugin {point.name} ({point.value}) must be a module with a file")
    path = Path(file)
    parts = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    state = hashlib.sha256()
    for part in parts:
        state.update(part.read_bytes())
    return module, Source(path, state.hexdigest(), installed=True)


def _add(module: ModuleType, source: Source) -> None:
    methods = _read_table(module, source, "METHODS", Method)
    faults = _read_table(module, source, "ENCODER_FAULTS", EncoderFault)
    if not methods and not faults:
        raise InputError(f"plugin {source.file} has neither METHODS nor ENCODER_FAULTS, so it adds nothing")
    for table, added in ((METHODS, methods), (ENCODER_FAULTS, faults)):
        for name in [name for name, record in table.items() if record.source and record.source.file == source.file]:
            del table[name]
        for name, record in added.items():
            _check_name(name, table, source)
            table[name] = replace(record, source=source)


def _read_table(module: ModuleType, source: Source, name: str, kind: type[Any]) -> dict[str, Any]:
    table = getattr(module, name, {})
    wrong = [key for key, value in table.items() if not isinstance(value, kind)] if isinstance(table, Mapping) else [""]
    if wrong:
        raise InputError(f"plugin {source.file}: {name} must map names to deepgps.{kind.__name__}")
    return dict(table)


def _check_name(name: object, table: Mapping[str, Any], source: Source) -> None:
    if not isinstance(name, str) or not NAME.fullmatch(name) or name in TAKEN:
        raise InputError(f"plugin {source.file}: {quote(name)} cannot be a name; lower-case letters, digits and _ can")
    before = table[name].source if name in table else None
    if (name in table and (before is None or before.file != source.file)) or name in EncoderSettings.model_fields:
        by = f"by {before.file}" if before else "by deepgps itself"
        raise InputError(f"plugin {source.file}: the name {name} is taken, {by}")
