"""The run folder: where a run is stored, which files it consists of, and which process may work in it."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from deepgps.config.methods import METHODS
from deepgps.config.plugins import check_plugins
from deepgps.config.scenario import Scenario, check_scenario, read_yaml, write_out
from deepgps.runs.inputs import check_inputs, digest, list_inputs, note_inputs
from deepgps.runs.owned_folder import COMPLETION_FILE, FRESH_FOLDER, Kind, choose_place, discard, hold, replace
from sim.errors import DamagedError, InputError
from sim.files.atomic import remove_empty, remove_files, sweep
from sim.files.checksums import check_lines, drop_sum, write_lines
from sim.recording.format import RECORDING, WORK_PATH, is_whole

TRAINED_FILES = r"positioner\.json|training\.json|weights\.safetensors|history\.npz|map\.npz|checkpoint\.pt"
METRICS, TRUTHLESS_METRICS = "metrics.json", "without_truth.json"
"""Figures of a run, and those of a run on a recording without truth."""
VIEWED = "run.rrd"  # File that the viewer shows of a run
FEATURE_FILES = r"features\.(safetensors|key)"


def drop_viewed(run: Path) -> None:
    """Remove what the viewer shows of a run, part of which is about to change; the viewer makes it again."""
    drop_sum(run / VIEWED)
    (run / VIEWED).unlink(missing_ok=True)


def find_run_files() -> re.Pattern[str]:
    """Pattern of the paths, within a run's folder, of all files of a run with any method that is known now."""
    return _make_pattern(tuple(METHODS))


@lru_cache
def _make_pattern(known: tuple[str, ...]) -> re.Pattern[str]:
    methods = "|".join(known)
    return re.compile(
        rf"scenario\.yaml|inputs\.json|timing\.json|log\.txt|metrics\.json|without_truth\.json|diagnosis\.json|(error|label|use)_field\.npz|failure\.txt"
        rf"|({methods})/(attempt\d+/)?({TRAINED_FILES})|({methods})/alignment\.json|features/({FEATURE_FILES})"
        rf"|(run|recording|pairs/[0-9a-f]{{12}})\.rrd(\.sha256)?|figures/(error_fields|error_cdf|drive)\.png"
        rf"|tracking/({methods})(-[0-9a-f]{{8}})?\.(npz|json|png)"
        rf"|navigate/(to/|changed/)?(metrics\.json|({methods}|dead_reckoning|truth)\.(npz|rrd)|parts/({methods}|dead_reckoning|truth)-\d{{4,}}\.npz)"
        # a study's run has links in place of a recording and of features
        rf"|features|recording|recording/({RECORDING.pattern})|recording\.collecting/({WORK_PATH.pattern})"
    )


RUN = Kind("run", "scenario.yaml", find_run_files)


def default_folder(scenario: Scenario) -> Path:
    """Run folder of a scenario if the user names none: runs/<scenario>/seed<seed>-<hash>."""
    return Path("runs") / scenario.name / f"seed{scenario.seed}-{digest(scenario)}"


def open_run(folder: Path) -> Scenario:
    """Scenario of an existing run folder; raises InputError if the folder holds no run."""
    path = folder / RUN.first
    if not path.is_file():
        raise InputError(describe_no_run(folder))
    try:
        check_lines(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; restore it from a copy, or make the run again with --fresh") from None
    return check_scenario(read_yaml(path), path)


def list_runs(folder: Path) -> list[Path]:
    """Folders of runs in a folder, one or two levels down, in order of their names."""
    scenarios = (path for pattern in ("*", "*/*") for path in folder.glob(f"{pattern}/{RUN.first}"))
    found = {path.parent for path in scenarios if path.is_file()}
    return sorted(path for path in found if path.name != FRESH_FOLDER)  # which is half a run


def is_study(folder: Path) -> bool:
    """Whether a folder is a study's."""
    return (folder / "study.yaml").is_file()


def describe_no_run(folder: Path) -> str:
    """What is wrong with a folder that holds no run."""
    if not folder.exists():
        return f"{folder} does not exist"
    if not folder.is_dir():
        return f"{folder} is a file, and a run is a folder"
    if runs := list_runs(folder):
        more = f", and {len(runs) - 8} more" if len(runs) > 8 else ""
        return f"{folder} is a folder of runs; choose one: {', '.join(map(str, runs[:8]))}{more}"
    return f"{folder} is no run folder: it has no scenario.yaml"


def list_trained(folder: Path) -> list[str]:
    """Methods that are trained in a run folder."""
    return sorted(path.parent.name for path in folder.glob("*/positioner.json"))


def join_methods(scenario: Scenario, folder: Path) -> Scenario:
    """The same scenario with the methods that are trained in its run folder already: no training is thrown away."""
    if not (folder / RUN.first).is_file():
        return scenario
    held = open_run(folder)
    if not is_same_but_methods(held, scenario):
        return scenario  # which claiming the folder refuses
    trained = [name for name in held.methods if name in list_trained(folder)]
    methods = (*trained, *(name for name in scenario.methods if name not in trained))
    if set(methods) == set(held.methods):
        return held
    return check_scenario({**held.model_dump(mode="json"), "methods": methods}, folder / RUN.first)


def is_same_but_methods(one: Scenario, other: Scenario) -> bool:
    """Whether two scenarios differ at most in their methods."""
    return one.model_dump(exclude={"methods"}) == other.model_dump(exclude={"methods"})


def find_place(folder: Path, fresh: bool) -> Path:
    """Folder that a run works in: the run folder, or, with ``fresh`` and a run already there, a subfolder."""
    return choose_place(folder, RUN, fresh)


@contextmanager
def claim(scenario: Scenario, folder: Path, fresh: bool) -> Iterator[Path]:
    """Lock a run folder for one process and one scenario, and yield the folder to work in.

    With ``fresh``, an existing run stays intact until the new one is complete. Raises InputError if the folder does not
    belong to deepgps, is in use, or holds another run, or a plugin that the scenario needs is not loaded.
    """
    check_plugins(scenario)
    cut_off = (folder / FRESH_FOLDER / COMPLETION_FILE).is_file()
    with hold(folder, RUN):
        if cut_off and fresh and open_run(folder) == scenario:
            fresh = False  # killed while replacing the old run; the replacement is finished now
        place = find_place(folder, fresh)
        if place != folder:
            _refuse_unknown_methods(folder)
        if (place / RUN.first).is_file():
            _compare(scenario, folder, place)
        sweep(place, RUN.files)
        begun = (place / RUN.first).is_file()
        if not begun:
            note_inputs(place, list_inputs(scenario))
            write_lines(place / RUN.first, write_out(scenario))
        try:
            yield place
        except InputError:
            # Wrong input leaves nothing behind, unless it is found so late that there is work to lose.
            if not begun and not _holds_work(place):
                for name in ("recording", "recording.collecting"):
                    remove_empty(place / name, place)
                discard(folder, place, RUN)
            raise
        if place != folder:
            replace(folder, RUN)


def _compare(scenario: Scenario, folder: Path, place: Path) -> None:
    """Raise InputError if a folder holds another run; remove what a killed --fresh of another left.

    A run of the same scenario with other methods takes the new ones, unless one is trained that would be lost.
    """
    if place != folder:
        try:
            same = open_run(place) == scenario
            check_inputs(place, scenario)
        except InputError:
            same = False
        if not same:
            remove_files(place, RUN.files)
        return
    held = open_run(folder)
    grown = is_same_but_methods(held, scenario) and set(list_trained(folder)) <= set(scenario.methods)
    if held != scenario and not grown:
        raise InputError(
            f"--out {folder} holds a run of another scenario ({describe_work(folder)}); choose another folder, or add "
            "--fresh, which replaces that run once the new one is complete"
        )
    check_inputs(folder, scenario)
    if held != scenario:
        write_lines(folder / RUN.first, write_out(scenario))


def _refuse_unknown_methods(folder: Path) -> None:
    """Raise InputError if a folder holds a training of a plugin's method, which --fresh would not know as ours."""
    if unknown := sorted(set(list_trained(folder)) - set(METHODS)):
        raise InputError(
            f"--out {folder} holds a training of {unknown[0]}, a method of a plugin that is not loaded; load it with "
            "--plugin, or choose another folder"
        )


def describe_work(folder: Path) -> str:
    """Describe what a run folder holds."""
    trained = list_trained(folder)
    return ", ".join(
        [
            "a recording" if is_whole(folder / "recording") else "no finished recording",
            f"trained {' and '.join(trained)}" if trained else "nothing trained",
            "measured" if any((folder / name).is_file() for name in (METRICS, TRUTHLESS_METRICS)) else "not measured",
        ]
    )


def _holds_work(folder: Path) -> bool:
    """Whether a run holds a training, or a recording of its own rather than a link to a study's."""
    recording = folder / "recording"
    return any(folder.glob("*/positioner.json")) or (is_whole(recording) and not recording.is_symlink())
