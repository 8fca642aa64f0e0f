"""What a run is made from that is not its own, by checksum: files of the user's room and robot, a recording elsewhere.

They may change while the run exists. It is then not continued: it would be half of one room and half of another.
"""

import hashlib
from pathlib import Path

from deepgps.config.scenario import Scenario
from deepgps.config.scenario_digest import list_own_files, read_room
from sim.errors import InputError, shorten
from sim.files.checksums import read_json, write_json

FILE, RECORDING = "inputs.json", "recording"


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
