"""The first stage of a run: drive and record, derive from an earlier drive, or link a recording that exists."""

import logging
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepgps.config.scenario import Scenario
from deepgps.runs.inputs import digest_recording
from deepgps.runs.provenance import timed
from deepgps.runs.run_folder import find_place
from deepgps.runs.shared_drive import find_base, find_training_drive, keep_drive
from deepgps.runs.source import find_adopted
from deepgps.terminal.progress import Report
from sim.errors import DamagedError
from sim.recording.derive import derive
from sim.recording.format import Judge, check_recording, is_whole
from sim.sensors.catalog import SENSORS, list_carried
from sim.settings import SimSettings

log = logging.getLogger(__name__)


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
    from sim.sensors.camera.gl import choose_backend

    choose_backend()


def collect(scenario: Scenario, folder: Path, progress: Report, is_enough: Judge | None = None) -> None:
    """Make the recording, unless it is finished: from a stored one of the same drive, or else by driving.

    A drive that would end early goes on while ``is_enough`` denies that its recording is.
    """
    if find_adopted(folder) or is_whole(folder / "recording"):
        return
    with timed(folder, "collect"):
        if base := find_base(scenario, folder):
            progress("derive", 0, 1)
            derive(base, scenario.sim, scenario.seed, folder / "recording")
            progress("derive", 1, 1)
        else:
            make_recording(
                scenario, folder / "recording", progress, find_training_drive(scenario, folder), is_enough=is_enough
            )
            keep_drive(scenario, folder)


def make_recording(
    scenario: Scenario,
    folder: Path,
    progress: Report,
    base: Path | None = None,
    renderers: int | None = None,
    is_enough: Judge | None = None,
) -> None:
    """Drive and record: write the recording ``folder``, or what is missing of it.

    A base is a recording with the same training drive, which is shared unless it is damaged. Without a number of
    renderers, as many processes draw a room's images as pay on all cores. For ``is_enough`` see ``collect``.
    """
    if scenario.world != "room":
        from sim.planar.drive import collect as collect_plane

        return collect_plane(scenario.sim, scenario.seed, folder, progress)
    progress("drive", 0, scenario.drive.samples)  # the room is built before the robot moves
    from sim.recording.collect import collect as collect_room

    try:
        if base is not None:
            check_recording(base)
    except DamagedError as error:
        log.warning("%s; the drive is made again", error)
        base = None
    collect_room(scenario.sim, scenario.seed, folder, progress, renderers, base, is_enough)


def check_log(path: Path, scenario: Scenario) -> None:
    """Raise InputError if the log of a scenario's drive cannot be written to a file; choose a renderer for it."""
    from sim.robot_log.log import check_log as check

    check(path, scenario.sim)
    choose_renderer()


def write_log(scenario: Scenario, folder: Path, path: Path, progress: Report) -> None:
    """Write what the robot's computers would have recorded of the drive of a run's recording, unless it is written."""
    from sim.robot_log.log import write_log as write

    write(path, scenario.sim, scenario.seed, folder / "recording", digest_recording(scenario), progress)


def find_parts(settings: SimSettings) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 2) and (m, 2) [m] of the free floor of the rooms of a flat, and of its doorways."""
    from sim.tools.gallery import find_parts as find

    return find(settings.room)
