"""The second stage of a run: train its methods. What is trained already stays."""

from pathlib import Path

from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.methods.side_by_side import Training, choose_networks, count_processes, train_side_by_side
from deepgps.runs.provenance import timed
from deepgps.terminal.progress import Report
from sim.recording.format import is_whole, open_recording


def ask_for_device(scenario: Scenario, folder: Path) -> None:
    """Raise InputError if the recording is still to be made and the device for training on it does not exist here."""
    if scenario.learn.train.device.startswith("cuda") and not is_whole(folder / "recording"):
        from deepgps.learning.trainer import choose_device

        choose_device(scenario.learn.train.device)


def train(scenario: Scenario, folder: Path, progress: Report, processes: int | None = None) -> None:
    """Train each method that is not trained yet.

    Args:
        scenario: The scenario.
        folder: The run's folder, with its recording.
        progress: Called with each method's steps done and their number.
        processes: Most networks that are trained at once; None: one for each usable core.
    """
    from deepgps.methods.fit import fit_method
    from deepgps.positioner.stored_positioner import is_finished

    recording, seed = open_recording(folder / "recording"), training_seed(scenario)
    missing = [method for method in scenario.methods if not is_finished(folder_of(folder, method))]
    most = count_processes(scenario.learn) if processes is None else processes
    networks = choose_networks(missing, scenario.learn) if most > 1 else []
    if networks:
        place = folder / "recording"
        each = [Training(name, place, scenario.learn, seed, folder_of(folder, name)) for name in networks]
        with timed(folder, f"train {', '.join(networks)}"):
            train_side_by_side(each, most, progress)
    for method in scenario.methods:
        place = folder_of(folder, method)
        with timed(folder, f"train {method}", done=is_finished(place)):
            fit_method(method, recording, scenario.learn, seed, place, progress)


def training_seed(scenario: Scenario) -> int:
    """The seed of weights and shuffling: the scenario's, unless learning has one of its own."""
    return scenario.seed if scenario.learn.seed is None else scenario.learn.seed
