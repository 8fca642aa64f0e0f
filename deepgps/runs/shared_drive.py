"""The drive of an earlier run of the same scenario: what differs only in encoders, image faults or length shares it.

Recordings that differ only in deployment or test grid share the training drive, and have tests of their own.
"""

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from deepgps.config.scenario import Scenario
from deepgps.runs.owned_folder import FRESH
from sim.errors import InputError
from sim.recording.derive import explain_misfit
from sim.recording.format import is_whole, read_manifest
from sim.recording.manifest import Manifest
from sim.recording.training_drive import has_same_training_drive


def find_base(scenario: Scenario, run: Path) -> Path | None:
    """Find a recording from which that of a run can be derived, byte for byte as if it had been driven.

    Only finished runs beside this one in the folder of their scenario, ``runs/<scenario>``, are considered. A room of
    the user's own is driven each time, since its meshes may have changed.

    Args:
        scenario: The scenario of the run.
        run: The run's folder; with ``--fresh`` it is a subfolder, which shares nothing.
    """
    return _find(scenario, run, lambda base: not explain_misfit(base, scenario.sim, scenario.seed))


def find_training_drive(scenario: Scenario, run: Path) -> Path | None:
    """Find a recording with the training drive of a run's recording, whose tests are still to be drawn.

    Takes the arguments of ``find_base``, and considers the same runs.
    """
    return _find(scenario, run, lambda base: has_same_training_drive(base, scenario.sim, scenario.seed))


def _find(scenario: Scenario, run: Path, fits: Callable[[Path], bool]) -> Path | None:
    if run.name == FRESH or run.parent.name != scenario.name or scenario.room.mjcf or scenario.robot.mjcf:
        return None
    for manifest in sorted(run.parent.glob("*/recording/manifest.json")):
        if manifest.parent.parent != run and _is_sound(manifest.parent, fits):
            return manifest.parent
    return None


def _is_sound(recording: Path, fits: Callable[[Path], bool]) -> bool:
    try:
        manifest = read_manifest(recording)
        if not is_whole(recording) or not fits(recording):
            return False
    except (InputError, ValueError):  # it is damaged, or of settings that no longer exist
        return False
    # The exact track width cannot be had from a rounded one. Other versions of a package may draw other bytes.
    return not manifest.settings["encoder"]["track_error"] and _is_of_these_packages(manifest)


def _is_of_these_packages(manifest: Manifest) -> bool:
    """Whether a recording was made with the installed versions of the packages that determine its bytes."""
    made_with = (manifest.model_extra or {}).get("packages", {})
    try:
        return all(version(name) == number for name, number in made_with.items())
    except PackageNotFoundError:
        return False
