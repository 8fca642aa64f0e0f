"""The local engine: each run a process of its own, as many at once as there are cores; no server."""

import signal
from collections.abc import Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from deepgps.progress import Look, Report
from deepgps.scenario import Scenario
from deepgps.studies.study import Plan
from deepgps.studies.worker import Failures, count_steps, do_run
from sim.processes import end_with_parent, usable_cores


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
                pipe, process = _start(waiting[0], folder, record)
                active[pipe] = waiting.pop(0), process
            for pipe in wait(list(active)):
                assert isinstance(pipe, Connection)
                plan, process = active[pipe]
                try:
                    told = pipe.recv()
                except EOFError:  # the process has ended
                    process.join()
                    del active[pipe]
                    if process.exitcode and plan.run not in failed:
                        failed[plan.run] = f"its process ended with {process.exitcode}"
                    told = count_steps(plan.scenario)
                if isinstance(told, str):
                    failed[plan.run] = told
                else:
                    done[plan.run] = min(told, count_steps(plan.scenario))
                    progress(f"steps of {len(plans)} runs", sum(done.values()), total)
    finally:
        for _, process in active.values():
            process.terminate()
        for _, process in active.values():
            process.join()
    return failed


def work(scenario: Scenario, folder: Path, recording: str, record: bool, pipe: Connection) -> None:
    """In a process of its own: do one run, telling ``pipe`` the steps done and, where it failed, why."""
    end_with_parent()
    steps: dict[str, int] = {}

    def tell(label: str, done: int, total: int, look: Look | None = None) -> None:
        if total > 1:  # a training
            steps[label] = done
            pipe.send(sum(steps.values()))

    if reason := do_run(scenario, folder, recording, record, tell):
        pipe.send(reason)


def _start(plan: Plan, folder: Path, record: bool) -> tuple[Connection, BaseProcess]:
    context = get_context("spawn")
    pipe, end = context.Pipe(duplex=False)
    arguments = (plan.scenario, folder / "runs" / plan.run, plan.recording, record, end)
    process = context.Process(target=work, args=arguments)
    # Ctrl-C reaches all processes of a terminal; only this one shall answer. What is ignored now is so from the start.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        process.start()
    finally:
        signal.signal(signal.SIGINT, before)
    end.close()
    return pipe, process
