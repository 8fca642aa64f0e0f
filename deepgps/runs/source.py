"""What a command works on: a scenario that is driven, a run that exists, or a recording that exists."""

from collections.abc import Mapping
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Any

from deepgps.config.scenario import Scenario, Spell, load_scenario, names_in, override_scenario
from deepgps.config.spelling import as_option
from deepgps.runs.adopted_recording import DEFAULT_METHODS, MANIFEST, choose_folder, describe_recording, find_adopted
from deepgps.runs.run_folder import RUN, default_folder, describe_no_run, join_methods, list_runs, open_run
from sim.errors import InputError, shorten
from sim.paths import SCENARIOS


@dataclass(frozen=True)
class Source:
    """What a command works on.

    Attributes:
        scenario: The scenario of the run.
        folder: The run's folder.
        recording: The recording to train on, if it is not the run's own.
    """

    scenario: Scenario
    folder: Path
    recording: Path | None = None


def find_source(
    name: str, overrides: Mapping[str, Any], out: Path | None, fresh: bool = False, spell: Spell = as_option
) -> Source:
    """Find the scenario, the run or the recording of this name.

    Args:
        name: A name in assets/scenarios, the path of a YAML file, or the folder of a run or of a recording.
        overrides: Values by dotted name.
        out: The run's folder; None: the default of what is found.
        fresh: Whether the run is made again, so that what is in its folder does not matter.
        spell: How messages write the names of overrides.

    Raises:
        InputError: There is nothing of that name, or a setting is wrong.
    """
    if name not in names_in(SCENARIOS) and Path(name).is_dir():
        return _find_folder(Path(name), overrides, out, fresh, spell)
    scenario = load_scenario(name, overrides, spell)
    folder = out or default_folder(scenario)
    return Source(scenario if fresh else join_methods(scenario, folder), folder)


def _find_folder(folder: Path, overrides: Mapping[str, Any], out: Path | None, fresh: bool, spell: Spell) -> Source:
    recording = folder if isfile(folder / MANIFEST) else folder / "recording"
    if isfile(folder / RUN.first):
        held = open_run(folder)
        scenario = override_scenario(held.model_dump(mode="json"), folder / RUN.first, overrides, spell)
        if (out is None or out.resolve() == folder.resolve()) and set(overrides) <= {"methods"}:
            _refuse_part_of_study(folder)
            return Source(scenario if fresh else join_methods(scenario, folder), folder, find_adopted(folder))
        refuse_settings_of_drive(scenario, held, recording, overrides, spell)
    elif isfile(recording / MANIFEST):
        defaults = {"methods": list(DEFAULT_METHODS)}
        scenario = describe_recording(recording, {**defaults, **overrides})
        refuse_settings_of_drive(scenario, describe_recording(recording, defaults), recording, overrides, spell)
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

    Args:
        scenario: The scenario with the overrides.
        held: The scenario without them, or that of the run that holds the recording.
        recording: The recording's folder.
        overrides: Values by dotted name.
        spell: How the message writes their names.
    """
    if (scenario.sim, scenario.seed) != (held.sim, held.seed):
        made = [name for name in overrides if name.partition(".")[0] not in {"learn", "methods", "name"}]
        raise InputError(
            f"{', '.join(map(spell, made))}: the recording {recording} is made already; "
            f"with it, only {spell('methods')}, {spell('name')} and {spell('learn')}.* can be set"
        )


def _refuse_part_of_study(folder: Path) -> None:
    if isfile(folder.resolve().parent.parent / "study.yaml"):
        raise InputError(f"{folder} is a run of a study, which is not changed: name another folder with --out")


def _describe_strange(folder: Path) -> str:
    if list_runs(folder):
        return describe_no_run(folder)
    return (
        f"{shorten(str(folder), 300)} is neither a run (it has no {RUN.first}) nor a recording (it has no {MANIFEST})"
    )
