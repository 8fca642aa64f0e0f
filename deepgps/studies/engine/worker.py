"""One run of a study, in a worker process: train, measure and, on request, draw."""

import os
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from deepgps.config.methods import METHODS
from deepgps.config.plugins import load_plugins
from deepgps.config.scenario import Scenario
from deepgps.evaluation.measure import evaluate
from deepgps.methods.train import train
from deepgps.runs.run_folder import claim, list_trained
from deepgps.terminal.progress import Report
from sim.errors import InputError, WorkError, one_line
from sim.files.atomic import write_text
from sim.plugins import locate_failure

FAILURE = "failure.txt"
Failures = dict[str, str]  # reasons by the hash of the run


def do_run(
    scenario: Scenario, folder: Path, recording: str, progress: Report, plugins: Sequence[Path] = ()
) -> str | None:
    """Do the missing stages of one run on a finished recording.

    Args:
        scenario: The scenario to run.
        folder: The run's folder, in ``runs`` of the study's folder.
        recording: Name of the recording's folder, in ``recordings`` of the study's folder.
        progress: Called with the progress of each stage.
        plugins: Files of plugins, which this process loads unless it has.

    Returns:
        The reason why the run failed; None: the run is done.
    """
    # Torch reads these when it is imported, at the first run. One thread, since each worker has one core to itself.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        from deepgps.studies.engine.shared_trainings import leave_trainings, take_trainings

        load_plugins(plugins)
        with claim(scenario, folder, fresh=False):
            link = folder / "recording"
            if not link.is_symlink():
                link.symlink_to(Path("..") / ".." / "recordings" / recording)
            take_trainings(scenario, folder)
            train(scenario, folder, progress, processes=1)
            leave_trainings(scenario, folder)
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


def wants_gpu(scenario: Scenario) -> bool:
    """Whether a run trains on a GPU where there is one."""
    return scenario.learn.train.device != "cpu"


def count_steps(scenario: Scenario, folder: Path) -> int:
    """Number of training steps that a run lacks, without restarts; at least one, so that every run counts."""
    missing = set(scenario.methods) - set(list_trained(folder))
    return max(1, scenario.learn.train.steps * sum(METHODS[method].in_steps for method in missing))
