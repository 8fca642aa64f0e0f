"""The second stage of a run: train its methods. What is trained already stays.

Methods are trained side by side, each in a process of its own, as many at once as there are cores for their threads. A
training fixes its number of threads and its random numbers, so it gives the same bytes in a process of its own.
Features that several methods share are computed by the first that needs them, while the others wait.
"""

import re
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from subprocess import Popen

from deepgps.config.learning import LearnSettings
from deepgps.config.methods import METHODS, folder_of
from deepgps.config.scenario import Scenario
from deepgps.runs.provenance import timed
from deepgps.runs.run_folder import TRAINED_FILES
from deepgps.terminal.progress import Look, Report, ignore
from sim.errors import InputError, WorkError
from sim.files.atomic import remove_files
from sim.processes import start_process, usable_cores
from sim.recording.format import Judge, Recording, is_whole, open_recording

TRAINING_FILES = re.compile(TRAINED_FILES)  # Paths of a training's files in its method's folder


def ask_for_device(scenario: Scenario, folder: Path) -> None:
    """Raise InputError if the recording is still to be made and the device for training on it does not exist here."""
    if scenario.learn.train.device.startswith("cuda") and not is_whole(folder / "recording"):
        from deepgps.learning.trainer import choose_device

        choose_device(scenario.learn.train.device)


def train(scenario: Scenario, folder: Path, progress: Report, processes: int | None = None) -> None:
    """Train each method that is not trained yet in a run's folder, with its recording.

    At most ``processes`` are trained at once; None: one for each usable core.
    """
    from deepgps.methods.fit import fit_method
    from deepgps.positioner.stored_positioner import is_finished

    recording, seed = open_recording(folder / "recording"), training_seed(scenario)
    missing = [method for method in scenario.methods if not is_finished(folder_of(folder, method))]
    most = count_processes(scenario.learn) if processes is None else processes
    long = choose_long(missing, scenario.learn, len(recording.observation)) if most > 1 else []
    if long:
        place = folder / "recording"
        each = [Training(name, place, scenario.learn, seed, folder_of(folder, name)) for name in long]
        with timed(folder, f"train {', '.join(long)}"):
            train_side_by_side(each, most, progress)
    for method in scenario.methods:
        place = folder_of(folder, method)
        with timed(folder, f"train {method}", done=is_finished(place)):
            fit_method(method, recording, scenario.learn, seed, place, progress)


def make_judge(scenario: Scenario, folder: Path, progress: Report = ignore) -> Judge | None:
    """What says whether registration places the images of a recording within ``drive.until.radius_m``, if that is set.

    What is learned for that stays in a run's ``folder`` if they are.
    """
    largest_m, place = scenario.drive.until.radius_m, folder_of(folder, "registration")
    if largest_m is None:
        return None

    def is_enough(recording: Recording) -> bool:
        from deepgps.methods.fit import fit_method
        from deepgps.positioner.stored_positioner import read_training

        progress("judge the images", 0, 1)
        remove_files(place, TRAINING_FILES)  # what a killed process learned may be of other images
        with suppress(InputError):  # too few segments pass one another yet
            fit_method("registration", recording, scenario.learn, training_seed(scenario), place)
            if read_training(place)["left_out_m"] <= largest_m:
                return True
        remove_files(place, TRAINING_FILES)
        return False

    return is_enough


def training_seed(scenario: Scenario) -> int:
    """The seed of weights and shuffling: the scenario's, unless learning has one of its own."""
    return scenario.seed if scenario.learn.seed is None else scenario.learn.seed


MIN_STEPS, MIN_IMAGES = 500, 4000
"""A process of its own pays for so many steps or images; what is shorter takes about as long as importing torch."""
PERIOD_S = 1.0  # Interval at which a training's history is sent to the parent


@dataclass(frozen=True)
class Training:
    """One method's training: its name, the recording's folder, how it learns, its seed and the method's folder."""

    method: str
    recording: Path
    settings: LearnSettings
    seed: int
    folder: Path

    def __call__(self, progress: Report) -> None:
        """Train, or continue."""
        from deepgps.methods.fit import fit_method

        recording = open_recording(self.recording)
        fit_method(self.method, recording, self.settings, self.seed, self.folder, progress)


def choose_long(methods: Sequence[str], settings: LearnSettings, images: int) -> list[str]:
    """Those methods that pay to be trained side by side; none on one core, and none on a GPU, which they would share.

    A method that is added by a plugin or a program is known in that process alone.
    """
    from deepgps.learning.trainer import choose_device

    ours = [name for name in methods if str(METHODS[name].fit).startswith("deepgps.")]
    in_steps = settings.train.steps >= MIN_STEPS
    long = [name for name in ours if images >= MIN_IMAGES or (in_steps and METHODS[name].in_steps)]
    pays = len(long) > 1 and count_processes(settings) > 1
    return long if pays and choose_device(settings.train.device).type == "cpu" else []


def count_processes(settings: LearnSettings) -> int:
    """Number of trainings that the usable cores have room for."""
    return max(1, usable_cores() // settings.train.threads)


def train_side_by_side(trainings: Sequence[Training], most: int, progress: Report) -> None:
    """Train each method in a process of its own, ``most`` at a time; the first error, or a death, ends them all.

    Every training continues from its checkpoint when it is started again.
    """
    waiting = list(trainings)
    with ExitStack() as ending:
        active: dict[Connection, tuple[Training, Popen[bytes]]] = {}
        while waiting or active:
            while waiting and len(active) < most:
                pipe, process = _start(ending)
                active[pipe] = waiting.pop(0), process
                with suppress(BrokenPipeError):  # it has died, as reading from it will show
                    pipe.send(active[pipe][0])
            for pipe in wait(list(active)):
                assert isinstance(pipe, Connection)
                training, process = active[pipe]
                try:
                    message = pipe.recv()
                except (EOFError, OSError):
                    raise WorkError(f"training {training.method}: its process ended with {process.wait()}") from None
                if isinstance(message, tuple):
                    label, done, total, history = message
                    progress(label, done, total, None if history is None else partial(dict, history))
                elif isinstance(message, BaseException):
                    raise message
                else:
                    process.wait()
                    del active[pipe]


def work(handle: int) -> None:
    """Do the training that arrives through the pipe of this file descriptor: the main function of a child process."""
    from deepgps.terminal.console import warn_plainly
    from deepgps.terminal.streams import open_streams

    open_streams()
    warn_plainly()
    pipe = Connection(handle)
    training: Training = pipe.recv()
    try:
        training(_send_steps(pipe))
        pipe.send(None)
    except BrokenPipeError:  # the parent is gone
        return
    except Exception as error:
        error.add_note(traceback.format_exc())
        pipe.send(error)


def _send_steps(pipe: Connection) -> Report:
    sent: dict[str, float] = {}

    def report(label: str, done: int, total: int, look: Look | None = None) -> None:
        history, now = None, time.monotonic()
        if look is not None and (done == total or now - sent.get(label, -PERIOD_S) >= PERIOD_S):
            history, sent[label] = look(), now
        pipe.send((label, done, total, history))

    return report


def _start(ending: ExitStack) -> tuple[Connection, Popen[bytes]]:
    pipe, end = Pipe()  # killed in the end: every file is written atomically
    code = "from deepgps.methods.train import work; work(int(sys.argv[1]))"
    process = start_process(code, [str(end.fileno())], [end.fileno()])
    end.close()
    stop: Callable[[], object]
    for stop in (pipe.close, process.wait, process.kill):
        ending.callback(stop)
    return pipe, process
