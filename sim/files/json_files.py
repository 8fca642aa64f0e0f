"""JSON files that hold the SHA-256 of their own values."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.errors import DamagedError
from sim.files.atomic import write_text
from sim.files.checksums import damaged

CHECKSUM = "checksum"


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file atomically, with keys in the order given and a checksum of all values last."""
    sealed = {**value, CHECKSUM: _digest_json(value)}
    write_text(path, json.dumps(sealed, indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that ``write_json`` made.

    Raises:
        DamagedError: The file is missing, truncated or changed.
    """
    try:
        value = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    except (ValueError, RecursionError) as error:
        raise damaged(path, f"it is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise damaged(path, f"it holds a {type(value).__name__} and no mapping")
    expected = value.pop(CHECKSUM, None)
    if expected is not None and expected != _digest_json(value):
        raise damaged(path)
    return value


def _digest_json(value: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(value, indent=1).encode()).hexdigest()
