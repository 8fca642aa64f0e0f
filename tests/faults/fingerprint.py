"""What a run or a study holds, by name, in a form in which two of them can be compared."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

BY_BYTES = {".npy", ".npz", ".safetensors", ".key", ".glb", ".png", ".parquet", ".yaml", ".md"}
TIME = re.compile(r"^(Time:|[\d.]+ s in all|in all|all\.$|This command took|look at it:|.* is done:|copied to)")
TIMINGS = re.compile(r"\.(checksum|train_s|collect_s|timing_s\b.*|environment\b.*|renderer_deaths)$")
LAST_CELL = re.compile(rb"\|[^|]*\|$", re.MULTILINE)  # of a study's table: seconds of training
LAST_COLUMN = re.compile(r"(\bS?E2\s+)[\d.]+\s*$")
Print = dict[str, str]
"""A value for each name: a file's checksum by its path, a figure of a JSON file by its path and key."""


def take(folder: Path) -> Print:
    """The fingerprint of a run's or a study's folder.

    Left out are files about the making, not the result: logs, locks, times, marks and recordings for the viewer.
    """
    found: Print = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_file() or path.name.startswith(".") or path.name in {"timing.json", "log.txt"}:
            continue
        if path.suffix == ".json":
            found |= {f"{name}:{key}": value for key, value in _leaves(path).items()}
        elif path.suffix in BY_BYTES:
            data = path.read_bytes()
            found[name] = hashlib.sha256(LAST_CELL.sub(b"", data) if path.suffix == ".md" else data).hexdigest()
    return found


def same_in(first: Print, second: Print) -> Print:
    """The part of a fingerprint that is the same in two clean runs: without times and what depends on them."""
    return {name: value for name, value in first.items() if second.get(name) == value and not TIMINGS.search(name)}


def differences(expected: Print, found: Print, without: frozenset[str] = frozenset()) -> list[str]:
    """Names at which a folder is not what it should be, but for the files ``without``."""
    wrong = [name for name, value in expected.items() if found.get(name) != value]
    return [name for name in wrong if name.partition(":")[0] not in without]


def figures_printed(out: str) -> list[str]:
    """The lines that a command prints, without times and paths."""
    return [LAST_COLUMN.sub(r"\1", line).rstrip() for line in out.splitlines() if line.strip() and not TIME.match(line)]


def _leaves(path: Path) -> dict[str, str]:
    try:
        return _flatten(json.loads(path.read_text(encoding="utf-8")), "")
    except ValueError:
        return {"": hashlib.sha256(path.read_bytes()).hexdigest()}


def _flatten(value: Any, name: str) -> dict[str, str]:
    if isinstance(value, Mapping):
        return {key: leaf for part in value for key, leaf in _flatten(value[part], f"{name}.{part}").items()}
    return {name: json.dumps(value)}
