"""The stages of a run: collect, train, evaluate. Each continues where it was interrupted."""

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.adopted_recording import find_adopted
from deepgps.owned_folder import is_older
from deepgps.progress import Report
from deepgps.provenance import describe_environment
from deepgps.run_folder import METRICS, RUN, WITHOUT_TRUTH, find_place
from deepgps.scenario import Scenario
from deepgps.scenario_digest import digest_recording
from deepgps.shared_drive import find_base, find_training_drive
from deepgps.timing import stage_times, timed
from sim.errors import DamagedError, InputError, WorkError
from sim.files.arrays import read_arrays
from sim.files.checksums import drop_sum
from sim.files.json_files import read_json, write_json
from sim.recording.derive import derive
from sim.recording.format import check_recording, has_truth, is_whole, open_recording
from sim.renamed import name_methods
from sim.sensors.catalog import SENSORS, list_carried
from sim.settings import WorldName

log = logging.getLogger(__name__)
NO_TESTS = "all methods are trained; errors cannot be measured, since the recording holds no test observations"


def list_undriven(scenario: Scenario, folder: Path, fresh: bool) -> list[Scenario]:
    """The scenario if a run of it still has to make its recording; a finished one needs no MuJoCo and no renderer."""
    place = find_place(folder, fresh)
    return [] if is_whole(place / "recording") or find_base(scenario, place) else [scenario]


def choose_renderer_for(scenarios: Sequence[Scenario]) -> None:
    """Choose the renderer by the sensors of these scenarios, which are still to be driven."""
    rooms = [scenario for scenario in scenarios if scenario.world == "room"]
    if any(SENSORS[name].renders for scenario in rooms for name in list_carried(scenario)):
        choose_renderer()
    elif rooms:
        os.environ["MUJOCO_GL"] = "off"  # MuJoCo reads this when it is imported: a lidar needs no OpenGL


def choose_renderer() -> None:
    """Choose a renderer that works on this machine; raises WorkError if there is none."""
    from sim.sensors.gl import choose_backend

    choose_backend()


def ask_for_device(scenario: Scenario, folder: Path) -> None:
    """Raise InputError if the recording is still to be made and the device for training on it does not exist here."""
    if scenario.learn.train.device.startswith("cuda") and not is_whole(folder / "recording"):
        from deepgps.learning.trainer import choose_device

        choose_device(scenario.learn.train.device)


def collect(scenario: Scenario, folder: Path, progress: Report) -> None:
    """Make the recording, unless it is finished: from an earlier run of the same drive, or else by driving."""
    if not find_adopted(folder) and not is_whole(folder / "recording"):
        with timed(folder, "collect"):
            if not derive_from_base(scenario, folder, progress):
                make_recording(scenario, folder / "recording", progress, find_training_drive(scenario, folder))


def derive_from_base(scenario: Scenario, folder: Path, progress: Report) -> bool:
    """Derive a run's recording from that of an earlier run, if one has the same drive; return whether that was done."""
    base = find_base(scenario, folder)
    if base is None:
        return False
    label = f"derive from {base.parent.name}"
    progress(label, 0, 1)
    try:
        derive(base, scenario.sim, scenario.seed, folder / "recording")
    except DamagedError as error:
        log.warning("%s; the drive is made again", error)
        choose_renderer_for([scenario])
        return False
    progress(label, 1, 1)
    return True


def make_recording(
    scenario: Scenario, folder: Path, progress: Report, base: Path | None = None, renderers: int | None = None
) -> None:
    """Drive and record: write the recording ``folder``, or what is missing of it.

    Args:
        scenario: The scenario.
        folder: The recording's folder.
        progress: Called with the progress of driving and rendering.
        base: A recording with the same training drive, which is shared unless it is damaged; None: there is none.
        renderers: Processes that draw a room's images; None: as many as pay on all cores.
    """
    if base is not None:
        try:
            check_recording(base)
            return _record_room(scenario, folder, progress, renderers, base)
        except DamagedError as error:
            log.warning("%s; the drive is made again", error)
    RECORD[scenario.world](scenario, folder, progress, renderers)


def check_log(path: Path, scenario: Scenario) -> None:
    """Raise InputError if the log of a scenario's drive cannot be written to a file; choose a renderer for it."""
    from sim.robot_log.check import check_log as check

    check(path, scenario.sim)
    choose_renderer()


def write_log(scenario: Scenario, folder: Path, path: Path, progress: Report) -> None:
    """Write what the robot's computers would have recorded of the drive of a run's recording, unless it is written."""
    from sim.robot_log.log import write_log as write

    write(path, scenario.sim, scenario.seed, folder / "recording", digest_recording(scenario), progress)


def train(scenario: Scenario, folder: Path, progress: Report) -> None:
    """Train each method that is not trained yet."""
    from deepgps.methods.catalog import folder_of
    from deepgps.methods.fit import fit_method
    from deepgps.methods.stored_positioner import is_finished

    recording = open_recording(folder / "recording")
    seed = training_seed(scenario)
    for method in scenario.methods:
        place = folder_of(folder, method)
        with timed(folder, f"train {method}", done=is_finished(place)):
            fit_method(method, recording, scenario.learn, seed, place, progress)


def training_seed(scenario: Scenario) -> int:
    """The seed of weights and shuffling: the scenario's, unless learning has one of its own."""
    return scenario.seed if scenario.learn.seed is None else scenario.learn.seed


def evaluate(scenario: Scenario, folder: Path, progress: Report) -> dict[str, Any] | None:
    """Measure all methods; write ``metrics.json``, ``error_field.npz`` and each method's alignment.

    On a recording without truth, ``without_truth.json`` is written in their place. Returns the file's contents; None if
    the recording holds the truth, but no test observations to measure errors at.
    """
    from deepgps.evaluation.evaluate import align_methods
    from deepgps.evaluation.evaluate import evaluate as measure

    metrics = read_measured(folder)
    if metrics and set(scenario.methods) <= set(name_methods(metrics["methods"])):
        if not is_older(folder, RUN):
            align_methods(folder, scenario)
        return metrics
    if not has_truth(folder / "recording"):
        return evaluate_without_truth(scenario, folder, progress)
    if not open_recording(folder / "recording").test_observation.size:
        return None
    with timed(folder, "evaluate"):
        measured = measure(folder, scenario, progress)
    remove_recording_of_run(folder)
    head = {"scenario": scenario.title, "seed": scenario.seed}
    made_with = describe_environment(folder, measured["methods"].values())
    tail = {"timing_s": stage_times(folder), "environment": made_with}
    write_json(folder / METRICS, {**head, **measured, **tail})
    return read_json(folder / METRICS)


def evaluate_without_truth(scenario: Scenario, folder: Path, progress: Report) -> dict[str, Any]:
    """Write what can be said of all methods without the truth: ``without_truth.json``."""
    from deepgps.evaluation.without_truth import judge, read_judged

    judged = read_judged(folder)
    if judged and set(scenario.methods) <= set(judged["methods"]):
        return judged
    with timed(folder, "evaluate"):
        judged = judge(folder, scenario, progress)
    remove_recording_of_run(folder)
    write_json(folder / WITHOUT_TRUTH, judged)
    return judged


def remove_recording_of_run(folder: Path) -> None:
    """Remove the Rerun recording of figures that are about to change; it is made again with the new ones."""
    drop_sum(folder / "run.rrd")
    (folder / "run.rrd").unlink(missing_ok=True)


def read_measured(folder: Path) -> dict[str, Any] | None:
    """The contents of a run's ``metrics.json``; None if that file or an error field is missing or damaged."""
    if not (folder / METRICS).is_file():
        return None
    try:
        metrics = read_json(folder / METRICS)
        for field, measured in (("error", True), ("label", "labels" in metrics), ("use", "in_use" in metrics)):
            if measured:
                read_arrays(folder / f"{field}_field.npz")
    except DamagedError as error:
        log.warning("%s; the methods are measured again", error)
        return None
    return metrics


def draw_views(scenario: Scenario, poses: np.ndarray) -> np.ndarray | None:
    """Draw large fisheye pictures (n, rows, columns, 3) at poses (n, 3); None if this machine cannot draw the room."""
    from sim.sensors.gl import choose_backend

    try:
        choose_backend()
        from sim.tools.pictures import draw_round

        return draw_round(scenario.sim, poses)
    except (InputError, WorkError) as error:
        log.info("the viewer goes without large pictures: %s", error)
        return None


def _record_room(
    scenario: Scenario, folder: Path, progress: Report, renderers: int | None, base: Path | None = None
) -> None:
    from sim.recording.collect import collect as collect_room

    collect_room(scenario.sim, scenario.seed, folder, progress, renderers, base)


def _record_landmarks(scenario: Scenario, folder: Path, progress: Report, renderers: int | None) -> None:
    from sim.planar.landmarks import collect as collect_landmarks

    collect_landmarks(scenario.sim, scenario.seed, folder, progress)


def _record_obstacles(scenario: Scenario, folder: Path, progress: Report, renderers: int | None) -> None:
    from sim.planar.obstacles import collect as collect_lidar

    collect_lidar(scenario.sim, scenario.seed, folder, progress)


RECORD: dict[WorldName, Callable[[Scenario, Path, Report, int | None], None]] = {
    "room": _record_room,
    "landmarks": _record_landmarks,
    "obstacles": _record_obstacles,
}


STAGES: dict[str, Callable[[Scenario, Path, Report], Any]] = {
    "collect": collect,
    "train": train,
    "evaluate": evaluate,
}
