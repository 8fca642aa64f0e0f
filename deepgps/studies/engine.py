"""The engine of a study: first every missing recording, then every missing run, each in a process of its own.

A recording is made by all cores, so one follows another; a training takes one core, so as many run at once as there
are. What is done is a file in a folder named by a hash of all it depends on: nothing else is remembered, and a study
that was killed, or that has grown, does what is missing.
"""

import os
import signal
import traceback
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from deepgps.progress import Report
from deepgps.run import claim, clear, evaluate, lock, make_recording, show, train
from deepgps.scenario import Scenario
from deepgps.studies.study import Plan, Study, write_out
from sim.errors import InputError, WorkError
from sim.files import sweep, write_text
from sim.processes import end_with_parent

MARK = "study.yaml"
FAILURE = "failure.txt"
TRAINED = ("deepgps", "posenet", "posenet_noisy", "odometry")  # step by step
Failures = dict[str, str]  # reasons by the hash of the run


def default_folder(study: Study) -> Path:
    """Where a study lies when the user names no folder: runs/studies/<name>."""
    return Path("runs") / "studies" / study.name


def carry_out(study: Study, plans: Sequence[Plan], folder: Path, fresh: bool, progress: Report) -> Failures:
    """Do all of a study's runs that are not done.

    Args:
        study: What to run.
        plans: Its runs.
        folder: The study's folder.
        fresh: Whether to throw away what stands there and begin anew.
        progress: Told how far recordings and runs are.

    Returns:
        Why runs failed; the others are done.
    """
    with lock(folder):
        if fresh or not (folder / MARK).is_file():
            clear(folder, MARK)
        sweep(folder)
        write_text(folder / MARK, write_out(study))
        missing = [plan for plan in plans if not is_done(folder, plan, study.record)]
        unrecorded = record_all(missing, folder, progress)
        ready = [plan for plan in missing if plan.recording not in unrecorded]
        failed = {plan.run: unrecorded[plan.recording] for plan in missing if plan.recording in unrecorded}
        return {**failed, **run_all(ready, folder, study.record, progress)}


def is_done(folder: Path, plan: Plan, record: bool) -> bool:
    """Whether a run's last file stands."""
    return (folder / "runs" / plan.run / ("recording.rrd" if record else "metrics.json")).is_file()


def record_all(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Make the recordings of these runs; returns why some failed, by the hash of the recording."""
    scenarios = {plan.recording: plan.scenario for plan in plans}
    total, before, failed = sum(one.drive.samples for one in scenarios.values()), 0, {}
    for key, scenario in scenarios.items():
        part = _half_and_half(progress, before, scenario.drive.samples, total)
        try:
            make_recording(scenario, folder / "recordings" / key, part)
        except (InputError, WorkError, OSError) as error:
            failed[key] = f"recording: {_one_line(error)}"
        before += scenario.drive.samples
        progress("recordings", before, total)
    return failed


def run_all(plans: Sequence[Plan], folder: Path, record: bool, progress: Report) -> Failures:
    """Train and measure these runs, as many at once as there are cores; returns why some failed."""
    failed, done = {}, {plan.run: 0 for plan in plans}
    total, waiting = sum(_steps(plan.scenario) for plan in plans), list(plans)
    active: dict[Connection, tuple[Plan, BaseProcess]] = {}
    try:
        while waiting or active:
            while waiting and len(active) < (os.cpu_count() or 1):
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
                    told = _steps(plan.scenario)
                if isinstance(told, str):
                    failed[plan.run] = told
                else:
                    done[plan.run] = min(told, _steps(plan.scenario))
                    progress(f"steps of {len(plans)} runs", sum(done.values()), total)
    finally:
        for _, process in active.values():
            process.terminate()
        for _, process in active.values():
            process.join()
    return failed


def work(scenario: Scenario, folder: Path, recording: str, record: bool, pipe: Connection) -> None:
    """In a process of its own: do one run, telling ``pipe`` the steps done and, where it failed, why."""
    # Read when torch is imported, which is not yet. The cores are shared out already.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ["OMP_NUM_THREADS"] = "1"
    end_with_parent()
    steps: dict[str, int] = {}

    def tell(label: str, done: int, total: int) -> None:
        if total > 1:  # a training
            steps[label] = done
            pipe.send(sum(steps.values()))

    try:
        with claim(scenario, folder, fresh=False):
            link = folder / "recording"
            if not link.is_symlink():
                link.symlink_to(Path("..") / ".." / "recordings" / recording)
            train(scenario, folder, tell)
            evaluate(scenario, folder, tell)
            if record:
                show(scenario, folder, tell)
            (folder / FAILURE).unlink(missing_ok=True)
    except (InputError, WorkError, OSError) as error:
        pipe.send(_one_line(error))
    except Exception as error:  # a fault of ours must not take the other runs with it
        with suppress(OSError):
            write_text(folder / FAILURE, traceback.format_exc())
        pipe.send(f"{type(error).__name__}: {_one_line(error)} ({folder / FAILURE})")


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


def _half_and_half(progress: Report, before: int, size: int, total: int) -> Report:
    """One bar of driving and rendering: each counts half of a recording's samples."""
    share: dict[str, float] = {}

    def report(label: str, done: int, of: int) -> None:
        share[label] = done / of
        progress("recordings", before + round(size * sum(share.values()) / 2), total)

    return report


def _steps(scenario: Scenario) -> int:
    """Training steps of a run without restarts; one at least, so that every run counts."""
    return max(1, scenario.learn.train.steps * sum(method in TRAINED for method in scenario.methods))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
