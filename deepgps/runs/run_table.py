"""A table of runs: what each changes in its scenario, how far it is, its errors, and its age."""

import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from deepgps.config.methods import title_of
from deepgps.config.scenario import Scenario, list_settings, load_scenario, names_in
from deepgps.config.spelling import as_option
from deepgps.runs.run_folder import METRICS, RUN, TRUTHLESS_METRICS, describe_no_run, list_runs, open_run
from sim.errors import InputError
from sim.files import SCENARIOS
from sim.files.atomic import write_size
from sim.files.checksums import damaged, read_json
from sim.recording.format import is_whole

HEADINGS = ("run", "age", "disk", "RMS (median) [cm]", "differs from its scenario by")
UNITS = ((86400, "d"), (3600, "h"), (60, "min"), (1, "s"))


def tabulate_runs(folder: Path) -> str:
    """The runs in a folder, oldest first, as a plain table; raises InputError if it does not exist, or holds no run."""
    runs = [folder] if (folder / RUN.first).is_file() else list_runs(folder)
    if not runs:
        raise InputError(f"{folder} holds no runs" if folder.is_dir() else describe_no_run(folder))
    runs.sort(key=_find_time)
    rows = [HEADINGS, *(_describe(run, run if run == folder else run.relative_to(folder)) for run in runs)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEADINGS))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def measure_disk(folder: Path) -> int:
    """Bytes of all files in a folder; a file with several names counts once."""
    found = [path.lstat() for path in folder.rglob("*") if path.is_file() or path.is_symlink()]
    return sum({one.st_ino: one.st_size for one in found}.values())


def list_differences(scenario: Scenario) -> dict[str, Any]:
    """Settings in which a scenario differs from the one of its name, or from the defaults, by dotted name."""
    base, own = _list_base(scenario.name), list_settings(scenario)
    return {name: value for name, value in own.items() if name != "name" and base.get(name) != value}


def compare_with_latest(run: Path) -> str | None:
    """A sentence on the latest run beside this one that differs in one group of settings; None: there is none."""
    own, errors = list_settings(open_run(run)), _read_errors(run)
    for other in sorted(list_runs(run.parent), key=_find_time, reverse=True):
        try:
            theirs, their_errors = list_settings(open_run(other)), _read_errors(other)
        except InputError:
            continue
        names = [name for name in own if own[name] != theirs.get(name) and name != "methods"]
        both = [name for name in errors if name in their_errors]
        if both and len({name.partition(".")[0] for name in names}) == 1:
            changes = " ".join(f"{as_option(name)} {_write(own[name])} ({_write(theirs.get(name))})" for name in names)
            pairs = (f"{title_of(name)} {errors[name]} ({their_errors[name]})" for name in both)
            return f"Beside {other.name} (in brackets): {changes}. RMS, median [cm]: {'; '.join(pairs)}."
    return None


def write_age(seconds: float) -> str:
    """An age in its largest unit, such as ``3 h``."""
    size, unit = next((size, unit) for size, unit in UNITS if seconds >= size or size == 1)
    return f"{max(0, int(seconds // size))} {unit}"


def _describe(run: Path, name: Path) -> tuple[str, ...]:
    first = (str(name), write_age(time.time() - _find_time(run)), write_size(measure_disk(run)))
    try:
        changes = [f"{as_option(key)} {_write(value)}" for key, value in list_differences(open_run(run)).items()]
        return *first, _describe_errors(run), " ".join(changes) or "nothing"
    except InputError as error:
        return *first, "-", f"cannot be read: {error}"


def _describe_errors(run: Path) -> str:
    if (run / METRICS).is_file():
        return ", ".join(
            f"{title_of(name)} {one.rms:.1f} ({one.median:.1f})" for name, one in _read_errors(run).items()
        )
    if (run / TRUTHLESS_METRICS).is_file():
        return "no truth"
    return "not measured" if is_whole(run / "recording") else "no finished recording"


class _Errors(NamedTuple):
    rms: float  # [cm]
    median: float  # [cm]

    def __str__(self) -> str:
        return f"{self.rms:.1f}, {self.median:.1f}"


def _read_errors(run: Path) -> dict[str, _Errors]:
    """Errors of a run's methods, by their names; none: it has not been measured."""
    path = run / METRICS
    metrics = read_json(path) if path.is_file() else {"methods": {}}
    try:
        return {name: _Errors(100 * one["rms_m"], 100 * one["median_m"]) for name, one in metrics["methods"].items()}
    except (LookupError, TypeError, ValueError, AttributeError):
        raise damaged(path, "it does not list the errors of methods") from None


def _find_time(run: Path) -> float:
    """When a run was measured, or else begun [s]."""
    names = (METRICS, TRUTHLESS_METRICS, RUN.first)
    return next(run / name for name in names if (run / name).is_file()).stat().st_mtime


@cache
def _list_base(name: str) -> dict[str, Any]:
    return list_settings(load_scenario(name, {}) if name in names_in(SCENARIOS) else Scenario())


def _write(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, Sequence) and not isinstance(value, str) else str(value)
