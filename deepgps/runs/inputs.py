"""What a run is made from, by checksum: its scenario, files of an own room and robot, a recording elsewhere.

Files may change while the run exists. It is then not continued: it would be half of one room and half of another.
"""

import hashlib
from collections.abc import Callable
from os.path import isfile
from pathlib import Path

from deepgps.config.scenario import Scenario
from sim.errors import InputError, shorten
from sim.files.checksums import FORMAT, read_json, sha256, write_json
from sim.rooms.mjcf_files import list_files

FILE, RECORDING = "inputs.json", "recording"


def list_own_files(scenario: Scenario) -> dict[str, str]:
    """The files of an own room and an own robot by the setting that names them."""
    files = {"room.mjcf": scenario.room.mjcf, "robot.mjcf": scenario.robot.mjcf}
    return {field: path for field, path in files.items() if path}


def read_room(path: str, field: str = "room.mjcf") -> bytes | None:
    """What tells a room or a robot from others: the bytes of its file, and the checksums of all files that it uses.

    Returns None if there is no file; raises InputError if one cannot be read or used, with the setting that names it.
    """
    if not isfile(Path(path)):
        return None
    own, *used = list_files(Path(path), "room" if field == "room.mjcf" else "robot")
    return own.read_bytes() + b"".join(bytes.fromhex(sha256(one)) for one in used)


def digest(scenario: Scenario, read: Callable[[str, str], bytes | None] = read_room) -> str:
    """Eight hexadecimal digits of the resolved scenario, the format and the files of an own room or robot.

    A caller that hashes many scenarios of one room can cache what ``read_room`` returns.
    """
    return _hash(scenario.model_dump_json(), scenario, read)


def digest_recording(scenario: Scenario, read: Callable[[str, str], bytes | None] = read_room) -> str:
    """The same digest of the settings that determine the recording."""
    return _hash(f"{scenario.seed} {scenario.sim.model_dump_json()}", scenario, read)


def digest_drive(scenario: Scenario, settings: str) -> str:
    """The same digest of those ``settings`` that determine a drive, whatever is measured on it."""
    return _hash(f"{scenario.seed} {settings}", scenario, read_room)


def _hash(settings: str, scenario: Scenario, read: Callable[[str, str], bytes | None]) -> str:
    learned = "" if scenario.drive.until.radius_m is None else scenario.learn.model_dump_json()  # it ends the drive
    state = hashlib.sha256(f"{FORMAT} {settings}{learned}".encode())
    for field, path in list_own_files(scenario).items():
        state.update(read(path, field) or b"")
    return state.hexdigest()[:8]


def note_inputs(run: Path, inputs: dict[str, str]) -> None:
    """Write the checksums of more inputs, by name, into a run's folder; runs without any have no such file."""
    if inputs:
        write_json(run / FILE, {**read_inputs(run), **inputs})


def read_inputs(run: Path) -> dict[str, str]:
    """Checksums of a run's inputs by name; empty where it has none."""
    return read_json(run / FILE) if (run / FILE).is_file() else {}


def list_inputs(scenario: Scenario) -> dict[str, str]:
    """Checksums of the files of a scenario's own room and robot and all that they use, by setting; none if missing."""
    found = {field: read_room(path, field) for field, path in list_own_files(scenario).items()}
    return {field: hashlib.sha256(content).hexdigest() for field, content in found.items() if content}


def check_inputs(run: Path, scenario: Scenario) -> None:
    """Raise InputError if the room or the robot of a scenario has changed since a run was begun."""
    held = read_inputs(run)
    for field, checksum in list_inputs(scenario).items() if held else ():
        if held.get(field, checksum) != checksum:
            path = shorten(list_own_files(scenario)[field], 300)
            raise InputError(
                f"{field} {path} has changed since this run was begun, or a file that it uses; "
                "put the old one back, choose another folder, or add --fresh, which makes the run again"
            )
