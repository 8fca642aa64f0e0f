"""Digests of scenarios, which name runs and recordings, and of the files of an own room or robot."""

import hashlib
from collections.abc import Callable
from os.path import isfile
from pathlib import Path

from deepgps.config.scenario import Scenario
from sim.files.checksums import FORMAT, sha256
from sim.rooms.mjcf_files import list_files


def list_own_files(scenario: Scenario) -> dict[str, str]:
    """The files of an own room and an own robot by the setting that names them."""
    files = {"room.mjcf": scenario.room.mjcf, "robot.mjcf": scenario.robot.mjcf}
    return {field: path for field, path in files.items() if path}


def read_room(path: str, field: str = "room.mjcf") -> bytes | None:
    """What tells a room or a robot from others: the bytes of its file, and the checksums of all files that it uses.

    Args:
        path: Its file.
        field: The setting that names it, for messages.

    Returns:
        None if there is no file.

    Raises:
        InputError: A file cannot be read, or is none that a room can use.
    """
    if not isfile(Path(path)):
        return None
    own, *used = list_files(Path(path), "room" if field == "room.mjcf" else "robot")
    return own.read_bytes() + b"".join(bytes.fromhex(sha256(one)) for one in used)


def digest(scenario: Scenario, read: Callable[[str, str], bytes | None] = read_room) -> str:
    """Eight hexadecimal digits of the resolved scenario, the format and the files of an own room or robot.

    Args:
        scenario: The scenario.
        read: What ``read_room`` returns; a caller that hashes many scenarios of one room can cache it.
    """
    return _hash(scenario.model_dump_json(), scenario, read)


def digest_recording(scenario: Scenario, read: Callable[[str, str], bytes | None] = read_room) -> str:
    """The same digest of the settings that determine the recording."""
    return _hash(f"{scenario.seed} {scenario.sim.model_dump_json()}", scenario, read)


def digest_drive(scenario: Scenario, settings: str) -> str:
    """The same digest of those ``settings`` that determine a drive, whatever is measured on it."""
    return _hash(f"{scenario.seed} {settings}", scenario, read_room)


def _hash(settings: str, scenario: Scenario, read: Callable[[str, str], bytes | None]) -> str:
    state = hashlib.sha256(f"{FORMAT} {settings}".encode())
    for field, path in list_own_files(scenario).items():
        state.update(read(path, field) or b"")
    return state.hexdigest()[:8]
