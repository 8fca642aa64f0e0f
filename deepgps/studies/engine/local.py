"""The local engine: one worker process per core, at most four on a GPU, each doing run after run, without a server."""

from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from subprocess import Popen
from typing import NamedTuple

from deepgps.command.streams import open_streams
from deepgps.command.terminal import warn_plainly
from deepgps.plugins import list_files
from deepgps.progress import Look, Report
from deepgps.studies.engine.worker import Failures, count_steps, do_run, wants_gpu
from deepgps.studies.study import Plan
from sim.processes import start_process, usable_cores

MOST_ON_GPU = 4
"""Runs that train on a GPU at once."""


def run_all(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Train and measure these runs, whose recordings are finished.

    Args:
        plans: The runs.
        folder: The study's folder.
        progress: Called with the training steps done and their number, summed over all runs.

    Returns:
        Reasons why runs failed, by the hash of the run.
    """
    failed, done = {}, {plan.run: 0 for plan in plans}
    steps = {plan.run: count_steps(plan.scenario, folder / "runs" / plan.run) for plan in plans}
    waiting, most = list(plans), count_workers(plans)
    active: dict[Connection, tuple[Plan, Popen[bytes]]] = {}
    try:
        while waiting or active:
            while waiting and len(active) < most:
                pipe, process = _start(folder)
                active[pipe] = _give(pipe, waiting), process
            for pipe in wait(list(active)):
                assert isinstance(pipe, Connection)
                plan, process = active[pipe]
                try:
                    update = pipe.recv()
                except (EOFError, OSError):  # the process has died, perhaps before it had read what it was given
                    failed[plan.run] = f"its process ended with {process.wait()}"
                    update = Update(0, ended=True)
                if update.failure:
                    failed[plan.run] = update.failure
                done[plan.run] = steps[plan.run] if update.ended else min(update.steps, steps[plan.run])
                progress(f"steps of {len(plans)} runs", sum(done.values()), sum(steps.values()))
                if update.ended and waiting and process.poll() is None:
                    active[pipe] = _give(pipe, waiting), process
                elif update.ended:
                    pipe.close()  # which ends the process
                    process.wait()
                    del active[pipe]
    finally:
        for _, process in active.values():
            process.kill()  # safe: files are written atomically
        for _, process in active.values():
            process.wait()
    return failed


def count_workers(plans: Sequence[Plan]) -> int:
    """Number of runs at once: one for each core, but few on a GPU, whose memory they share."""
    if any(wants_gpu(plan.scenario) for plan in plans):
        import torch

        if torch.cuda.is_available():
            return min(usable_cores(), MOST_ON_GPU)
    return usable_cores()


class Update(NamedTuple):
    """Message of a worker process: its run's training steps done, whether the run has ended, and why it failed."""

    steps: int
    ended: bool = False
    failure: str | None = None


def work(handle: int) -> None:
    """Do the runs that arrive through a pipe until it is closed; this is the main function of a worker process.

    Args:
        handle: File descriptor of the pipe, which carries the study's folder and the files of plugins, then the runs.
    """
    open_streams()
    warn_plainly()
    pipe = Connection(handle)
    with suppress(EOFError, BrokenPipeError):  # the parent needs no more, or is gone
        folder, plugins = pipe.recv()
        while True:
            _do(pipe.recv(), folder, plugins, pipe)


def _do(plan: Plan, folder: Path, plugins: Sequence[Path], pipe: Connection) -> None:
    steps: dict[str, int] = {}

    def tell(label: str, done: int, total: int, look: Look | None = None) -> None:
        if look is not None:  # a training
            steps[label] = done
            pipe.send(Update(sum(steps.values())))

    failure = do_run(plan.scenario, folder / "runs" / plan.run, plan.recording, tell, plugins)
    pipe.send(Update(sum(steps.values()), ended=True, failure=failure))


def _give(pipe: Connection, waiting: list[Plan]) -> Plan:
    plan = waiting.pop(0)
    _send(pipe, plan)
    return plan


def _start(folder: Path) -> tuple[Connection, Popen[bytes]]:
    pipe, end = Pipe()
    code = "from deepgps.studies.engine.local import work; work(int(sys.argv[1]))"
    process = start_process(code, [str(end.fileno())], [end.fileno()])
    end.close()
    _send(pipe, (folder, list_files()))
    return pipe, process


def _send(pipe: Connection, message: object) -> None:
    with suppress(BrokenPipeError):  # the process has died, as reading from it will show
        pipe.send(message)
