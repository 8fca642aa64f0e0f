"""The local engine: one worker process per core, as far as they fit on a GPU, each doing run after run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deepgps.config.plugins import list_plugins
from deepgps.config.scenario import Scenario
from deepgps.studies.engine.pool import Tell, do_all
from deepgps.studies.engine.worker import Failures, count_steps, do_run, wants_gpu
from deepgps.studies.plan import Plan
from deepgps.terminal.progress import Look, Report
from sim.processes import usable_cores

GPU_BYTES = 3 * 2**30
"""Memory of a GPU that is kept for each run; those of ``samples`` took about 1.5 GB each on an H100."""


@dataclass(frozen=True)
class RunTask:
    """A run to do in a worker process; see ``do_run``. Its size is the number of training steps that it lacks."""

    scenario: Scenario
    folder: Path
    recording: str
    size: int
    plugins: Sequence[Path]

    def __call__(self, tell: Tell) -> str | None:
        """Do the run."""
        steps: dict[str, int] = {}

        def report(label: str, done: int, total: int, look: Look | None = None) -> None:
            if look is not None:  # a training
                steps[label] = done
                tell(sum(steps.values()))

        return do_run(self.scenario, self.folder, self.recording, report, self.plugins)


def run_all(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Train and measure these runs, whose recordings are finished.

    Args:
        plans: The runs.
        folder: The study's folder.
        progress: Called with the training steps done and their number, summed over all runs.

    Returns:
        Reasons why runs failed, by the hash of the run.
    """
    runs = {plan.run: _make_run(plan, folder / "runs" / plan.run) for plan in plans}
    total = sum(run.size for run in runs.values())
    return do_all(runs, count_workers(plans), lambda done: progress(f"steps of {len(plans)} runs", done, total))


def _make_run(plan: Plan, folder: Path) -> RunTask:
    return RunTask(plan.scenario, folder, plan.recording, count_steps(plan.scenario, folder), list_plugins())


def count_workers(plans: Sequence[Plan]) -> int:
    """Number of runs at once: one for each core, as most of a run needs no GPU, unless a GPU has too little memory."""
    if any(wants_gpu(plan.scenario) for plan in plans):
        import torch

        if torch.cuda.is_available():
            fitting = torch.cuda.get_device_properties(0).total_memory // GPU_BYTES
            return max(1, min(usable_cores(), fitting))
    return usable_cores()
