"""The store of drives: ``runs/drives/<digest>/<recording>/`` holds hard links to the recordings that runs have driven.

A drive has a digest: that of its seed, settings, files and packages. A run in the usual folder, ``runs/<scenario>``, is
made from a stored recording, byte for byte as if it had been driven: what differs only in encoders, image faults or
length shares the drive; what differs in deployment or test grid shares the training drive, and has tests of its own.
"""

import logging
import os
import re
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from deepgps.config.scenario import Scenario
from deepgps.runs.inputs import digest_drive, digest_recording
from sim.errors import DamagedError, InputError
from sim.files.atomic import PART, link_file, list_files, remove_files
from sim.recording.derive import choose_drive, explain_misfit, has_same_training_drive, keep_training_settings
from sim.recording.format import RECORDING, check_recording
from sim.recording.manifest import PACKAGES

STORE = "drives"  # Folder of the store in ``runs``
STORED_PATH = re.compile(rf"[0-9a-f]{{8}}/[0-9a-f]{{8}}/({RECORDING.pattern})")  # Paths of the files in a store
log = logging.getLogger(__name__)


def find_base(scenario: Scenario, run: Path) -> Path | None:
    """Find a stored recording from which that of a run can be derived; a damaged one is removed.

    A run elsewhere than in ``runs/<scenario>`` shares nothing, nor does one of ``--fresh``.
    """
    return _find(scenario, run, lambda base: not explain_misfit(base, scenario.sim, scenario.seed))


def find_training_drive(scenario: Scenario, run: Path) -> Path | None:
    """Find a stored recording with the training drive of a run's recording, whose tests are still to be drawn.

    Takes the arguments of ``find_base``.
    """
    return _find(scenario, run, lambda base: has_same_training_drive(base, scenario.sim, scenario.seed))


def keep_drive(scenario: Scenario, run: Path) -> None:
    """Store the recording that a run has driven, so that later runs can share it; takes the arguments of ``find_base``.

    That of a track width with an error is not stored, since the exact one cannot be had from the rounded one.
    """
    stored = _find_home(scenario) / digest_recording(scenario)
    if not _may_share(scenario, run) or scenario.encoder.track_error or stored.exists():
        return
    part = stored.with_name(f"{stored.name}.{os.getpid()}{PART}")
    for path in list_files(run / "recording", RECORDING):
        link_file(path, part / path.relative_to(run / "recording"))
    try:
        part.rename(stored)
    except OSError:  # another process has just stored it
        remove_files(part, RECORDING)


def measure_store(runs: Path) -> int:
    """Bytes of all files in the store of a folder of runs, which runs may share."""
    return sum(path.stat().st_size for path in list_files(runs / STORE, STORED_PATH))


def empty_store(runs: Path) -> None:
    """Remove all files in the store of a folder of runs; the runs keep theirs."""
    remove_files(runs / STORE, STORED_PATH)


def _find(scenario: Scenario, run: Path, fits: Callable[[Path], bool]) -> Path | None:
    if not _may_share(scenario, run):
        return None
    for manifest in sorted(_find_home(scenario).glob(f"{8 * '[0-9a-f]'}/manifest.json")):
        try:
            if fits(manifest.parent):
                check_recording(manifest.parent)
                return manifest.parent
        except DamagedError as error:
            log.warning("%s; the drive is made again", error)
            remove_files(manifest.parent, RECORDING)
        except InputError as error:
            log.warning("%s; it is not used", error)
    return None


def _may_share(scenario: Scenario, run: Path) -> bool:
    return run.resolve().parent == (Path("runs") / scenario.name).resolve()


def _find_home(scenario: Scenario) -> Path:
    """Folder of all stored recordings with the training drive of a scenario, whatever its length and encoders."""
    settings = keep_training_settings(choose_drive(scenario.sim, 0))
    packages = [version(name) for name in PACKAGES]
    return Path("runs") / STORE / digest_drive(scenario, f"{packages} {settings.model_dump_json()}")
