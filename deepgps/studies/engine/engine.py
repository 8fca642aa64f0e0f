"""The engine of a study: first every missing recording, then every missing run, one process to each core.

A recording is made by all cores, so one follows another; a training takes one core, so as many run at once as there
are. What is done is a file in a folder named by a hash of all it depends on: nothing else is remembered, and a study
that was killed, or that has grown, does what is missing, under this engine or another.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from deepgps.owned_folder import Kind, choose_place, discard, hold, replace
from deepgps.progress import Report
from deepgps.run_folder import FEATURE_FILES, RUN, TRAINED_FILES
from deepgps.scenario import Scenario
from deepgps.stages import read_measured
from deepgps.studies.catalog import PICTURES
from deepgps.studies.engine import local as engine_local
from deepgps.studies.engine import ray_cluster
from deepgps.studies.engine.shared_recordings import find_undriven, record_all
from deepgps.studies.engine.worker import Failures
from deepgps.studies.study import Plan, Study, write_out
from sim.errors import InputError
from sim.files import is_intact, sweep, write_lines
from sim.recording.format import COLLECTING, RECORDING

_HASH = "[0-9a-f]{8}"
STUDY = Kind(
    "study",
    "study.yaml",
    re.compile(
        rf"study\.yaml|table\.(md|parquet(\.sha256)?)|study\.rrd(\.sha256)?|figures/({'|'.join(PICTURES)})\.png"
        rf"|runs/{_HASH}/({RUN.files.pattern}|\.deepgps)|trainings/{_HASH}/({TRAINED_FILES}|{FEATURE_FILES})"
        rf"|recordings/{_HASH}/({RECORDING.pattern})|recordings/{_HASH}\.collecting/({COLLECTING.pattern})"
    ),
)
EngineName = Literal["local", "ray"]
RunAll = Callable[[Sequence[Plan], Path, bool, Report], Failures]


def default_folder(study: Study) -> Path:
    """Where a study lies when the user names no folder: runs/studies/<name>."""
    return Path("runs") / "studies" / study.name


@contextmanager
def open_engine(name: EngineName, address: str | None) -> Iterator[RunAll]:
    """What does the runs: processes of this machine, or tasks of the Ray cluster at an address; none: one started here.

    Raises:
        InputError: Ray is missing, or no cluster answers at the address.
    """
    if name == "ray":
        with ray_cluster.open_cluster(address) as run_all:
            yield run_all
    elif address is not None:
        raise InputError(f"--address {address} names a Ray cluster and needs --engine ray")
    else:
        yield engine_local.run_all


@contextmanager
def claim_study(study: Study, folder: Path, fresh: bool) -> Iterator[Path]:
    """Hold a study folder for one process.

    Args:
        study: What is run.
        folder: The study's folder.
        fresh: Whether a study that is there is replaced. It stays whole until the new one is complete.

    Yields:
        The folder to work in.

    Raises:
        InputError: The folder is not ours, or is in use.
    """
    with hold(folder, STUDY):
        place = find_place(folder, fresh)
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


def find_place(folder: Path, fresh: bool) -> Path:
    """Folder that a study works in: its own, or where ``fresh`` builds beside one that is there."""
    return choose_place(folder, STUDY, fresh)


def carry_out(study: Study, plans: Sequence[Plan], place: Path, run_all: RunAll, progress: Report) -> Failures:
    """Do all of a study's runs that are not done.

    Args:
        study: What to run.
        plans: Its runs.
        place: The folder that it works in, which this process holds.
        run_all: Does runs whose recordings are made.
        progress: Told how far recordings and runs are.

    Returns:
        Why runs failed; the others are done.
    """
    missing = find_missing(study, plans, place)
    unrecorded = record_all(plans, missing, place, progress)
    ready = [plan for plan in missing if plan.recording not in unrecorded]
    failed = {plan.run: unrecorded[plan.recording] for plan in missing if plan.recording in unrecorded}
    return {**failed, **run_all(ready, place, study.record, progress)}


def find_missing(study: Study, plans: Sequence[Plan], place: Path) -> list[Plan]:
    """Runs whose last file is missing or damaged."""
    missing = []
    for plan in plans:
        run = place / "runs" / plan.run
        if read_measured(run) is None or (study.record and not is_intact(run / "run.rrd")):
            missing.append(plan)
    return missing


def list_undriven(study: Study, plans: Sequence[Plan], folder: Path, fresh: bool) -> list[Scenario]:
    """What ``carry_out`` would drive and look at."""
    place = find_place(folder, fresh)
    return list(find_undriven(plans, find_missing(study, plans, place), place).values())
