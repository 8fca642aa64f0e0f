"""The runs of a study, whose recordings are finished: train and measure each."""

import os
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from deepgps.config.methods import METHODS
from deepgps.config.plugins import list_plugins, load_plugins
from deepgps.config.scenario import Scenario
from deepgps.methods.train import train, training_seed
from deepgps.runs.run_folder import claim, list_trained
from deepgps.studies.engine.pool import Failures, Tell, do_all
from deepgps.studies.plan import Plan
from deepgps.terminal.progress import Look, Report
from sim.errors import InputError, WorkError, one_line
from sim.files.atomic import write_text
from sim.plugins import locate_failure
from sim.processes import usable_cores
from sim.recording.format import open_recording

FAILURE = "failure.txt"
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
    """Train and measure runs with finished recordings in local processes: one per core, as far as they fit on a GPU.

    Returns the reasons why runs failed, by the hash of the run.
    """
    tasks = {}
    for plan in plans:
        run = folder / "runs" / plan.run
        tasks[plan.run] = RunTask(plan.scenario, run, plan.recording, count_steps(plan.scenario, run), list_plugins())
    total = sum(task.size for task in tasks.values())
    return do_all(tasks, count_workers(plans), lambda done: progress(f"steps of {len(plans)} runs", done, total))


def do_run(
    scenario: Scenario, folder: Path, recording: str, progress: Report, plugins: Sequence[Path] = ()
) -> str | None:
    """Do the missing stages of one run on a finished recording, a folder in ``recordings`` of the study's folder.

    This process loads the files of plugins unless it has. Returns why the run failed; None: it is done.
    """
    # Torch reads these when it is imported, at the first run. One thread, since each worker has one core to itself.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        from deepgps.evaluation.measure_run import evaluate

        load_plugins(plugins)
        with claim(scenario, folder, fresh=False):
            link = folder / "recording"
            if not link.is_symlink():
                link.symlink_to(Path("..") / ".." / "recordings" / recording)
            share_features(scenario, folder)
            train(scenario, folder, progress, processes=1)
            evaluate(scenario, folder, progress)
            (folder / FAILURE).unlink(missing_ok=True)
    except (InputError, WorkError, OSError) as error:
        return one_line(error)
    except Exception as error:  # a bug must not stop the other runs
        with suppress(OSError):
            write_text(folder / FAILURE, traceback.format_exc())
        where = f"{plugin}: " if (plugin := locate_failure(error)) else ""
        return f"{where}{type(error).__name__}: {one_line(error)} (runs/{folder.name}/{FAILURE})"
    return None


def share_features(scenario: Scenario, run: Path) -> None:
    """Link a run to the features that a study's runs on the same images share; the first that needs them makes them."""
    from deepgps.learning.training_data import FEATURES, digest_features  # needs torch

    if not (run / FEATURES).exists():
        digest = digest_features(open_recording(run / "recording"), scenario.learn, training_seed(scenario))[:8]
        (run.parent.parent / FEATURES / digest).mkdir(parents=True, exist_ok=True)
        (run / FEATURES).unlink(missing_ok=True)  # a link to what somebody has removed
        (run / FEATURES).symlink_to(Path("..") / ".." / FEATURES / digest)


def count_workers(plans: Sequence[Plan]) -> int:
    """Number of runs at once: one for each core, as most of a run needs no GPU, unless a GPU has too little memory."""
    if any(wants_gpu(plan.scenario) for plan in plans):
        import torch

        if torch.cuda.is_available():
            fitting = torch.cuda.get_device_properties(0).total_memory // GPU_BYTES
            return max(1, min(usable_cores(), fitting))
    return usable_cores()


def wants_gpu(scenario: Scenario) -> bool:
    """Whether a run trains on a GPU where there is one."""
    return scenario.learn.train.device != "cpu"


def count_steps(scenario: Scenario, folder: Path) -> int:
    """Number of training steps that a run lacks, without restarts; at least one, so that every run counts."""
    missing = set(scenario.methods) - set(list_trained(folder))
    return max(1, scenario.learn.train.steps * sum(METHODS[method].in_steps for method in missing))
