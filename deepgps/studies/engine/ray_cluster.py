"""The Ray engine: each run is a task of one core, on this machine or on a cluster of machines that share the folder.

The recordings are made beforehand, on all cores of the machine where the command is given, so only that machine needs a
renderer. All others need the same version of this project installed. Without an address, a cluster of this machine's
cores is started, with a token that no other process knows; it ends with the command.
"""

import logging
import os
import secrets
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from deepgps.config.plugins import list_plugins
from deepgps.studies.engine.pool import Failures
from deepgps.studies.engine.runs import count_steps, do_run, wants_gpu
from deepgps.studies.plan import Plan
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError, one_line
from sim.processes import END_SIGNALS, usable_cores

RETRIES = 2  # How often to retry a run whose process or machine was lost; the run continues from its last checkpoint
CONNECTION_S = 5.0
ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # leaves the visible GPUs as they are, without a warning
}


@contextmanager
def open_cluster(address: str | None) -> Iterator[Callable[[Sequence[Plan], Path, Report], Failures]]:
    """Connect to the Ray cluster at an address (auto, host:port), or start one of this machine's cores, and leave it.

    Raises InputError if Ray is not installed, or no cluster answers.
    """
    if find_spec("ray") is None:
        raise InputError("--engine ray needs Ray: pip install ray (in a checkout: make setup-dev)")
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    own = {}
    if not address:
        own = {"num_cpus": usable_cores(), "include_dashboard": False}
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))  # else Ray leaves one in the user's home
    import ray

    try:
        _knock(address or "")
        with _keep_handlers():
            ray.init(address or "local", logging_level=logging.ERROR, log_to_driver=False, **own)
    except (OSError, ValueError, RuntimeError) as error:
        own_fault = "--engine ray: no Ray cluster can be started here"
        fault = f"--address {address}: no Ray cluster answers there" if address else own_fault
        raise InputError(f"{fault}: {one_line(error)}") from None
    try:
        yield partial(_run_all, ray)
    finally:
        ray.shutdown()


@contextmanager
def _keep_handlers() -> Iterator[None]:
    """Restore the signal handlers: Ray sets its own, and its handler of SIGTERM aborts with many lines of output."""
    before, ended = {number: signal.getsignal(number) for number in END_SIGNALS}, False
    try:
        yield
    except SystemExit:  # raised by Ray's own handler after it has ended Ray's processes
        ended = True
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if ended:
        signal.raise_signal(signal.SIGTERM)


def _run_all(ray: Any, plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Train and measure these runs like ``runs.run_all``; progress counts only the steps of ended runs."""
    failed, done = Failures(), 0
    steps = {plan.run: count_steps(plan.scenario, folder / "runs" / plan.run) for plan in plans}
    total = sum(steps.values())
    gpus = int("GPU" in ray.cluster_resources())
    running = {}
    for plan in plans:
        needs = {"num_cpus": 1, "num_gpus": gpus * wants_gpu(plan.scenario), "max_retries": RETRIES}
        home = folder.resolve() / "runs" / plan.run
        task = ray.remote(**needs)(do_run).remote(plan.scenario, home, plan.recording, ignore, list_plugins())
        running[task] = plan
    progress(f"steps of {len(plans)} runs", 0, total)
    while running:
        (task,), _ = ray.wait(list(running))
        plan = running.pop(task)
        try:
            reason = ray.get(task)
        except ray.exceptions.RayError as error:
            reason = f"its process was lost: {one_line(error)}"
        if reason:
            failed[plan.run] = reason
        done += steps[plan.run]
        progress(f"steps of {len(plans)} runs", done, total)
    return failed


def _knock(address: str) -> None:
    host, _, port = address.rpartition(":")
    if host and "/" not in host and port.isdigit():
        socket.create_connection((host, int(port)), timeout=CONNECTION_S).close()
