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

from deepgps.progress import Report
from deepgps.run import clear, lock
from deepgps.scenario import Scenario
from deepgps.studies import engine_local, engine_ray
from deepgps.studies.recordings import find_undriven, record_all
from deepgps.studies.study import Plan, Study, write_out
from deepgps.studies.worker import Failures
from sim.errors import InputError
from sim.files import sweep, write_text

MARK = "study.yaml"
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
        with engine_ray.open_cluster(address) as run_all:
            yield run_all
    elif address is not None:
        raise InputError(f"--address {address} names a Ray cluster and needs --engine ray")
    else:
        yield engine_local.run_all


def carry_out(
    study: Study, plans: Sequence[Plan], folder: Path, fresh: bool, run_all: RunAll, progress: Report
) -> Failures:
    """Do all of a study's runs that are not done.

    Args:
        study: What to run.
        plans: Its runs.
        folder: The study's folder.
        fresh: Whether to throw away what stands there and begin anew.
        run_all: Does runs whose recordings stand.
        progress: Told how far recordings and runs are.

    Returns:
        Why runs failed; the others are done.
    """
    with lock(folder):
        if fresh or not (folder / MARK).is_file():
            clear(folder, MARK)
        sweep(folder, re.compile(".*"))
        write_text(folder / MARK, write_out(study))
        missing = find_missing(study, plans, folder)
        unrecorded = record_all(plans, missing, folder, progress)
        ready = [plan for plan in missing if plan.recording not in unrecorded]
        failed = {plan.run: unrecorded[plan.recording] for plan in missing if plan.recording in unrecorded}
        return {**failed, **run_all(ready, folder, study.record, progress)}


def find_missing(study: Study, plans: Sequence[Plan], folder: Path) -> list[Plan]:
    """Runs whose last file does not stand."""
    last = "recording.rrd" if study.record else "metrics.json"
    return [plan for plan in plans if not (folder / "runs" / plan.run / last).is_file()]


def list_undriven(study: Study, plans: Sequence[Plan], folder: Path, fresh: bool) -> list[Scenario]:
    """What ``carry_out`` would drive and look at."""
    if fresh:
        return [plan.scenario for plan in plans]
    return list(find_undriven(plans, find_missing(study, plans, folder), folder).values())
