"""Plugins: methods and encoder faults from outside.

A plugin is a Python file with a table ``METHODS`` of ``deepgps.Method``, a table ``ENCODER_FAULTS`` of
``deepgps.EncoderFault``, or both, which are added to the tables of these names.
"""

import hashlib
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from deepgps.config.methods import METHODS, Method
from deepgps.config.scenario import Scenario
from sim.errors import InputError, quote, read_file, shorten
from sim.plugins import ENCODER_FAULTS, LOADING_HINT, MODULE_PREFIX, EncoderFault
from sim.settings import EncoderSettings

NAME = re.compile(r"[a-z][a-z0-9_]{0,40}")
RESERVED_NAMES = {"features", "recording", "figures", "pairs", "truth", "heading"}
"""Names that no method can have: folders of a run, and arrays of an error field."""
MAX_BYTES = 10 * 1024 * 1024


def load_plugins(files: Iterable[str | Path]) -> None:
    """Add what these plugins define to ``METHODS`` and ``ENCODER_FAULTS``; call it before scenarios are read.

    Raises InputError if a file cannot be read, is no plugin, or defines a name that is taken; an exception of a
    plugin's code is passed on.
    """
    for file in files:
        path = Path(file).absolute()
        name = MODULE_PREFIX + hashlib.sha256(str(path).encode()).hexdigest()[:8]
        before = sys.modules.get(name)
        module = _import(path, name)
        for attribute, table, kind in (("METHODS", METHODS, Method), ("ENCODER_FAULTS", ENCODER_FAULTS, EncoderFault)):
            for known in getattr(before, attribute, {}):
                table.pop(known, None)
            added = getattr(module, attribute, {})
            if not isinstance(added, dict) or not all(isinstance(record, kind) for record in added.values()):
                raise InputError(f"plugin {path}: {attribute} must map names to deepgps.{kind.__name__}")
            for own in added:
                if own in table or own in RESERVED_NAMES or own in EncoderSettings.model_fields:
                    raise InputError(f"plugin {path}: the name {own} is taken")
                if not isinstance(own, str) or not NAME.fullmatch(own):
                    raise InputError(f"plugin {path}: {quote(own)} is no name of lower-case letters, digits and _")
            table.update(added)


def list_plugins() -> list[Path]:
    """The files that are loaded as plugins, for other processes to load them too."""
    return sorted(Path(str(module.__file__)) for name, module in sys.modules.items() if name.startswith(MODULE_PREFIX))


def check_plugins(scenario: Scenario) -> None:
    """Raise InputError if a plugin that a scenario needs is not loaded."""
    missing = {
        **{f"method {name}": name in METHODS for name in scenario.methods},
        **{f"encoder.plugins.{name}": name in ENCODER_FAULTS for name in scenario.encoder.plugins},
    }
    for name, is_loaded in missing.items():
        if not is_loaded:
            raise InputError(f"{name}: no plugin that is loaded defines it; {LOADING_HINT}")


def _import(path: Path, name: str) -> ModuleType:
    code = read_file(path, MAX_BYTES, f"plugin {shorten(str(path), 300)}")
    module = ModuleType(name)
    module.__file__ = str(path)
    exec(compile(code, str(path), "exec"), module.__dict__)  # without a file of bytecode beside the user's file
    if not hasattr(module, "METHODS") and not hasattr(module, "ENCODER_FAULTS"):
        raise InputError(f"plugin {path} has neither METHODS nor ENCODER_FAULTS, so it adds nothing")
    sys.modules[name] = module
    return module
