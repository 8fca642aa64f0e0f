"""What a command works on: a scenario that is driven, a run that exists, or a recording that exists.

A run on a recording that exists has the scenario that describes it, and a link to it in its folder.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Any

from deepgps.config.scenario import Scenario, Spell, clean_name, load_scenario, names_in, override_scenario
from deepgps.config.spelling import as_option
from deepgps.runs.inputs import RECORDING, digest, note_inputs, read_inputs
from deepgps.runs.owned_folder import FRESH_FOLDER
from deepgps.runs.run_folder import RUN, default_folder, describe_no_run, join_methods, list_runs, open_run
from sim.errors import InputError, shorten
from sim.files import SCENARIOS
from sim.files.checksums import sha256
from sim.recording.format import is_whole, read_manifest

MANIFEST = "manifest.json"
DEFAULT_METHODS = ("deepgps",)
"""Methods that are trained on a recording if none are named: it may hold neither truth nor labels."""


@dataclass(frozen=True)
class Source:
    """What a command works on."""

    scenario: Scenario  # The scenario of the run
    folder: Path  # The run's folder
    recording: Path | None = None  # The recording to train on, if it is not the run's own


def find_source(name: str, overrides: Mapping[str, Any], out: Path | None, fresh: bool = False) -> Source:
    """Find the scenario, the run or the recording of a name in assets/scenarios, a YAML file's path, or a folder.

    Without ``out``, the run's folder is the default of what is found; with ``fresh``, what is in it does not matter.
    Raises InputError if nothing has the name, or a setting is wrong.
    """
    if name not in names_in(SCENARIOS) and Path(name).is_dir():
        return _find_folder(Path(name), overrides, out, fresh)
    scenario = load_scenario(name, overrides, as_option)
    folder = out or default_folder(scenario)
    return Source(scenario if fresh else join_methods(scenario, folder), folder)


def _find_folder(folder: Path, overrides: Mapping[str, Any], out: Path | None, fresh: bool) -> Source:
    recording = folder if isfile(folder / MANIFEST) else folder / "recording"
    if isfile(folder / RUN.first):
        held = open_run(folder)
        scenario = override_scenario(held.model_dump(mode="json"), folder / RUN.first, overrides, as_option)
        if (out is None or out.resolve() == folder.resolve()) and set(overrides) <= {"methods"}:
            if isfile(folder.resolve().parent.parent / "study.yaml"):
                raise InputError(f"{folder} is a run of a study, which is not changed: name another folder with --out")
            return Source(scenario if fresh else join_methods(scenario, folder), folder, find_adopted(folder))
        refuse_settings_of_drive(scenario, held, recording, overrides, as_option)
    elif isfile(recording / MANIFEST):
        defaults = {"methods": list(DEFAULT_METHODS)}
        scenario = describe_recording(recording, {**defaults, **overrides})
        refuse_settings_of_drive(scenario, describe_recording(recording, defaults), recording, overrides, as_option)
    else:
        raise InputError(_describe_strange(folder))
    if not isfile(recording / MANIFEST):
        raise InputError(f"{folder} has no finished recording: deepgps run {folder} continues it")
    place = out or choose_folder(recording, scenario)
    return Source(scenario if fresh else join_methods(scenario, place), place, recording)


def refuse_settings_of_drive(
    scenario: Scenario, held: Scenario, recording: Path, overrides: Mapping[str, Any], spell: Spell
) -> None:
    """Raise InputError if overrides change what the recording was made with.

    ``scenario`` has the overrides, ``held`` has not, or is that of the run that holds the recording.
    """
    if (scenario.sim, scenario.seed) != (held.sim, held.seed):
        made = [name for name in overrides if name.partition(".")[0] not in {"learn", "methods", "name"}]
        raise InputError(
            f"{', '.join(map(spell, made))}: the recording {recording} is made already; "
            f"with it, only {spell('methods')}, {spell('name')} and {spell('learn')}.* can be set"
        )


def _describe_strange(folder: Path) -> str:
    if list_runs(folder):
        return describe_no_run(folder)
    return (
        f"{shorten(str(folder), 300)} is neither a run (it has no {RUN.first}) nor a recording (it has no {MANIFEST})"
    )


def describe_recording(recording: Path, overrides: Mapping[str, Any]) -> Scenario:
    """The scenario of a training on a recording, by overrides and what its manifest knows of the world and the sensors.

    Raises InputError if it is no finished recording, or a setting is wrong.
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
    home = run.parent if run.name == FRESH_FOLDER else run
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

    Raises InputError if it is no longer where the link says, or another one is.
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
