"""The engine of a study: it makes every missing recording, then every missing run, several at once.

A drive and a training take one core each, so as many are done at once as there are cores. The only state is the
finished files, in folders named by a hash of everything they depend on. A study that was killed, or that has grown,
therefore does only what is missing, under any engine.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from deepgps.config.methods import find_method
from deepgps.config.plain_yaml import read_yaml
from deepgps.config.scenario import Scenario
from deepgps.evaluation.measure_run import read_measured
from deepgps.runs.owned_folder import Kind, choose_place, discard, hold, replace
from deepgps.runs.run_folder import FEATURE_FILES, RUN
from deepgps.studies.catalog import PICTURES
from deepgps.studies.engine import ray_cluster
from deepgps.studies.engine.pool import Failures
from deepgps.studies.engine.recordings import record_all
from deepgps.studies.engine.runs import run_all
from deepgps.studies.plan import Plan
from deepgps.studies.study import Study, write_out
from deepgps.terminal.progress import Report
from sim.errors import InputError, shorten
from sim.files.atomic import sweep
from sim.files.checksums import write_lines
from sim.processes import usable_cores
from sim.recording.format import RECORDING, WORK_PATH

IMAGE_S, LEARN_S, STEP_S, RUN_S = 0.012, 0.004, 0.02, 5.0
"""Core time on a slow machine: of driving to an image and drawing it, of learning from it by one method, of a step of a
training, and of all else in a run."""
FASTEST, TYPICAL_FLOOR_M2 = 3, 12.0  # A slow machine's time over a fast one's; floor that a test grid covers
_HASH = "[0-9a-f]{8}"


def find_study_files() -> re.Pattern[str]:
    """Pattern of the paths, within a study's folder, of all its files, with any method that is known now."""
    of_run = RUN.files.pattern
    return re.compile(
        rf"study\.yaml|table\.(md|parquet(\.sha256)?)|study\.rrd(\.sha256)?|figures/({'|'.join(PICTURES)})\.png"
        rf"|runs/{_HASH}/({of_run}|\.deepgps)|features/{_HASH}/({FEATURE_FILES})"
        rf"|recordings/{_HASH}/({RECORDING.pattern})|recordings/{_HASH}\.collecting/({WORK_PATH.pattern})"
    )


STUDY = Kind("study", "study.yaml", find_study_files)
EngineName = Literal["local", "ray"]
RunAll = Callable[[Sequence[Plan], Path, Report], Failures]


def find_place(folder: Path, fresh: bool) -> Path:
    """The folder that a study works in: its own or, with ``fresh`` and a study already there, a subfolder."""
    return choose_place(folder, STUDY, fresh)


@contextmanager
def open_engine(name: EngineName, address: str | None) -> Iterator[RunAll]:
    """Open an engine and yield the function that does the runs, in local processes or as Ray tasks.

    Without an address, a Ray cluster is started here. Raises InputError if Ray is missing, no cluster answers at the
    address, or another engine is given one.
    """
    if name == "ray":
        with ray_cluster.open_cluster(address) as run_on_cluster:
            yield run_on_cluster
    elif address is not None:
        raise InputError(f"--address {address} names a Ray cluster and needs --engine ray")
    else:
        yield run_all


@contextmanager
def claim_study(study: Study, folder: Path, fresh: bool) -> Iterator[Path]:
    """Hold a study folder for this process and yield the folder to work in.

    With ``fresh``, an existing study is replaced, and stays intact until the new one is complete. Raises InputError if
    the folder does not belong to deepgps, another process uses it, or it holds another study.
    """
    with hold(folder, STUDY):
        place = choose_place(folder, STUDY, fresh)
        if place == folder:
            _refuse_another(study, folder)
        sweep(place, STUDY.files)
        begun = (place / STUDY.first).is_file()
        write_lines(place / STUDY.first, write_out(study))
        try:
            yield place
        except InputError:
            if not begun and not any(place.glob("r*/*")):  # wrong input leaves nothing behind
                discard(folder, place, STUDY)
            raise
        if place != folder:
            replace(folder, STUDY)


def _refuse_another(study: Study, folder: Path) -> None:
    """Raise InputError if a folder holds a study of another name or scenario; one that has only grown is the same."""
    try:
        held = read_yaml(folder / STUDY.first)
    except InputError:  # there is none, or it is damaged and written again
        return
    name, scenario = str(held.get("name")), str(held.get("scenario"))
    if name != study.name or Path(scenario).stem != Path(study.scenario).stem:  # a study may be given by another path
        raise InputError(
            f"--out {folder} holds the study {shorten(name)} of the scenario {shorten(scenario, 300)}, not "
            f"{study.name} of {study.scenario}; choose another folder, or add --fresh, which replaces that study once "
            "the new one is complete"
        )


def carry_out(
    plans: Sequence[Plan], missing: Sequence[Plan], place: Path, run_all: RunAll, progress: Report
) -> Failures:
    """Do those of a study's runs that are missing in the folder that this process holds.

    Returns the reasons why runs failed, by the hash of the run; all other runs are done.
    """
    unrecorded = record_all(plans, missing, place, progress)
    ready = [plan for plan in missing if plan.recording not in unrecorded]
    failed = {plan.run: unrecorded[plan.recording] for plan in missing if plan.recording in unrecorded}
    return {**failed, **run_all(ready, place, progress)}


def find_missing(plans: Sequence[Plan], place: Path, progress: Report) -> list[Plan]:
    """Runs whose results are missing or damaged in the folder that a study works in."""
    missing = []
    for done, plan in enumerate(plans, start=1):
        if read_measured(place / "runs" / plan.run) is None:
            missing.append(plan)
        progress("look for runs", done, len(plans))
    return missing


def foresee(missing: Sequence[Plan], undriven: Sequence[Scenario]) -> str:
    """What a study lacks, and how long that takes from a fast machine to a slow one; nothing if it lacks nothing."""
    cores, images = usable_cores(), sum(map(_count_images, undriven))
    learning = sum(_foresee_learning(plan.scenario) for plan in missing)
    minutes = (IMAGE_S * images + learning) / min(cores, max(len(missing), 1)) / 60
    made = f"drives: {len(undriven)} (about {images:,} images with tests); runs: {len(missing)}"
    return f"{made}; {minutes / FASTEST:.0f} to {minutes + 1:.0f} min on {cores} idle cores" if missing else ""


def _count_images(scenario: Scenario) -> int:
    grid, drive = scenario.grid, scenario.drive.samples + scenario.deployment.drive_samples
    return round(drive + (grid.held_out or TYPICAL_FLOOR_M2 / grid.spacing_m**2 * grid.headings))


def _foresee_learning(scenario: Scenario) -> float:
    trained = [find_method(name).in_steps for name in scenario.methods]
    return RUN_S + sum(trained) * STEP_S * scenario.learn.train.steps + len(trained) * LEARN_S * scenario.drive.samples
