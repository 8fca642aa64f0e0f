"""A run on a recording that exists already: the scenario that describes it, and the link to it in the run's folder."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deepgps.config.scenario import Scenario, clean_name, override_scenario
from deepgps.config.scenario_digest import digest
from deepgps.runs.inputs import RECORDING, note_inputs, read_inputs
from deepgps.runs.owned_folder import FRESH
from sim.errors import InputError
from sim.files.checksums import sha256
from sim.recording.format import is_whole, read_manifest

MANIFEST = "manifest.json"
DEFAULT_METHODS = ("deepgps",)
"""Methods that are trained on a recording if none are named: it may hold neither truth nor labels."""


def describe_recording(recording: Path, overrides: Mapping[str, Any]) -> Scenario:
    """The scenario of a training on a recording, by what its manifest knows of the world and the sensors.

    Args:
        recording: The recording's folder.
        overrides: Values by dotted name, such as ``{"methods": ["deepgps"]}``.

    Raises:
        InputError: It is no finished recording, or a setting is wrong.
    """
    manifest = read_manifest(recording)
    seed = {} if manifest.seed is None else {"seed": manifest.seed}
    values = {"name": _name(recording), **manifest.settings, **seed}
    return override_scenario(values, recording / MANIFEST, overrides)


def choose_folder(recording: Path, scenario: Scenario) -> Path:
    """The folder of a run on a recording when the user names none: runs/<name>/seed<seed>-<hash>."""
    state = hashlib.sha256(f"{digest(scenario)} {sha256(recording / MANIFEST)}".encode())
    return Path("runs") / scenario.name / f"seed{scenario.seed}-{state.hexdigest()[:8]}"


def link_recording(recording: Path, run: Path) -> None:
    """Link a recording into a run's folder; raises InputError if it has another, or --fresh would remove it."""
    home = run.parent if run.name == FRESH else run
    if home != run and recording.resolve().is_relative_to(home.resolve()):
        raise InputError(f"--out {home} holds the recording itself, which --fresh would remove; choose another folder")
    link = run / "recording"
    if not link.is_symlink() and not link.exists():
        link.symlink_to(recording.resolve(), target_is_directory=True)
        note_inputs(run, {RECORDING: sha256(recording / MANIFEST)})
    elif link.resolve() != recording.resolve():
        raise InputError(f"{run} holds a run on another recording, {link.resolve()}; choose another folder")


def find_adopted(run: Path) -> Path | None:
    """The recording elsewhere that a run's folder links to; None: it has its own, or none yet.

    Raises:
        InputError: It is no longer where the link says, or another one is.
    """
    link = run / "recording"
    if not link.is_symlink():
        return None
    if not is_whole(link):
        raise InputError(f"{run}: its recording {link.resolve()} is missing or not finished; put it back")
    if read_inputs(run).get(RECORDING) not in {None, sha256(link / MANIFEST)}:
        raise InputError(
            f"{run}: its recording {link.resolve()} has been made again since; choose another folder for a run on it"
        )
    return link.resolve()


def _name(recording: Path) -> str:
    """Name of a run on a recording: that of its folder."""
    home = recording.resolve()
    return clean_name(home.parent.name if home.name == "recording" else home.name) or "recording"
