"""The local engine: as many processes as there are cores, each doing run after run; no server."""

from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NamedTuple

from deepgps.progress import Look, Report
from deepgps.studies.study import Plan
from deepgps.studies.worker import Failures, count_steps, do_run
from sim.processes import WORKERS, end_with_parent, usable_cores


def run_all(plans: Sequence[Plan], folder: Path, record: bool, progress: Report) -> Failures:
    """Train and measure these runs, whose recordings stand.

    Args:
        plans: The runs.
        folder: The study's folder.
        record: Whether to draw figures and write a Rerun recording for each.
        progress: Told how many training steps are done in all.

    Returns:
        Why some failed.
    """
    failed, done = {}, {plan.run: 0 for plan in plans}
    total, waiting = sum(count_steps(plan.scenario) for plan in plans), list(plans)
    active: dict[Connection, tuple[Plan, BaseProcess]] = {}
    try:
        while waiting or active:
            while waiting and len(active) < usable_cores():
                pipe, process = _start(folder, record)
                active[pipe] = _give(pipe, waiting), process
            for pipe in wait(list(active)):
                assert isinstance(pipe, Connection)
                plan, process = active[pipe]
                try:
                    told = pipe.recv()
                except EOFError:  # the process has died
                    process.join()
                    failed[plan.run] = f"its process ended with {process.exitcode}"
                    told = Told(0, ended=True)
                if told.failure:
                    failed[plan.run] = told.failure
                steps = count_steps(plan.scenario)
                done[plan.run] = steps if told.ended else min(told.steps, steps)
                progress(f"steps of {len(plans)} runs", sum(done.values()), total)
                if told.ended and waiting and process.is_alive():
                    active[pipe] = _give(pipe, waiting), process
                elif told.ended:
                    pipe.close()  # which ends the process
                    process.join()
                    del active[pipe]
    finally:
        for _, process in active.values():
            process.terminate()
        for _, process in active.values():
            process.join()
    return failed


class Told(NamedTuple):
    """What a process tells of its run: training steps done, whether it has ended, and if it failed, why."""

    steps: int
    ended: bool = False
    failure: str | None = None


def work(folder: Path, record: bool, pipe: Connection) -> None:
    """In a process of its own: do the runs that come through ``pipe``, until no more come."""
    end_with_parent()
    with suppress(EOFError):
        while True:
            _do(pipe.recv(), folder, record, pipe)


def _do(plan: Plan, folder: Path, record: bool, pipe: Connection) -> None:
    steps: dict[str, int] = {}

    def tell(label: str, done: int, total: int, look: Look | None = None) -> None:
        if total > 1:  # a training
            steps[label] = done
            pipe.send(Told(sum(steps.values())))

    failure = do_run(plan.scenario, folder / "runs" / plan.run, plan.recording, record, tell)
    pipe.send(Told(sum(steps.values()), ended=True, failure=failure))


def _give(pipe: Connection, waiting: list[Plan]) -> Plan:
    with suppress(BrokenPipeError):  # the process has died, as reading from it will show
        pipe.send(waiting[0])
    return waiting.pop(0)


def _start(folder: Path, record: bool) -> tuple[Connection, BaseProcess]:
    pipe, end = WORKERS.Pipe()
    process = WORKERS.Process(target=work, args=(folder, record, end))
    process.start()
    end.close()
    return pipe, process
