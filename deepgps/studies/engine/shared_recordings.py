"""The recordings of a study: runs that differ only in encoders, image faults or length share one drive.

A drive is collected once, at its greatest length and with the default encoders and images. All other recordings of the
drive are derived from it, which needs no simulator, and little disk space where the images are the same. Drives that
differ in deployment or test grid share all but their tests.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from deepgps.config.scenario import Scenario
from deepgps.config.scenario_digest import digest_recording
from deepgps.studies.engine.collecting import collect_all
from deepgps.studies.engine.worker import Failures
from deepgps.studies.plan import Plan
from deepgps.terminal.progress import Report
from sim.errors import InputError, WorkError, one_line
from sim.recording.derive import can_be_cut, choose_drive, derive
from sim.recording.format import is_whole
from sim.recording.training_drive import can_share, keep_training_settings


def record_all(plans: Sequence[Plan], missing: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Make the recordings that are missing.

    Args:
        plans: All runs of the study, which determine how long each drive must be.
        missing: Runs whose recordings are needed now.
        folder: The study's folder.
        progress: Called with the number of samples collected, then with the number of recordings derived.

    Returns:
        Reasons why recordings failed, by the hash of the recording.
    """
    drives, home = find_drives(plans), folder / "recordings"
    wanted = _find_wanted(missing, home)
    undriven = _choose_undriven(drives, wanted, home)
    unmade = collect_all(undriven, _find_bases(undriven, drives.values(), home), home, progress)
    failed: Failures = {}
    for done, (key, scenario) in enumerate(wanted.items(), start=1):
        drive = digest_recording(drives[key])
        if drive in unmade:
            failed[key] = unmade[drive]
        elif drive != key:
            failed |= _try_to_derive(home / drive, scenario, home / key)
        progress("derived", done, len(wanted))
    return failed


def find_undriven(plans: Sequence[Plan], missing: Sequence[Plan], folder: Path) -> dict[str, Scenario]:
    """Scenarios of drives still to collect for the missing runs, by hash; takes the arguments of ``record_all``."""
    home = folder / "recordings"
    return _choose_undriven(find_drives(plans), _find_wanted(missing, home), home)


def find_drives(plans: Sequence[Plan]) -> dict[str, Scenario]:
    """What to collect for each recording, by its hash: its drive at the greatest length, without any faults."""
    longest: dict[str, int] = {}
    for plan in plans:
        drive = _name_drive(plan.scenario)
        longest[drive] = max(longest.get(drive, 0), plan.scenario.drive.samples)
    return {plan.recording: _choose(plan.scenario, longest[_name_drive(plan.scenario)]) for plan in plans}


def _choose(scenario: Scenario, samples: int) -> Scenario:
    sim = choose_drive(scenario.sim, samples)
    return scenario.model_copy(update={"encoder": sim.encoder, "image_faults": sim.image_faults, "drive": sim.drive})


def _name_drive(scenario: Scenario) -> str:
    """A hash that is the same for all recordings of a drive."""
    return digest_recording(_choose(scenario, 0 if can_be_cut(scenario.sim) else scenario.drive.samples))


def _find_wanted(missing: Sequence[Plan], home: Path) -> dict[str, Scenario]:
    return {plan.recording: plan.scenario for plan in missing if not is_whole(home / plan.recording)}


def _choose_undriven(drives: dict[str, Scenario], wanted: Iterable[str], home: Path) -> dict[str, Scenario]:
    needed = {digest_recording(drives[key]): drives[key] for key in wanted}
    return {key: scenario for key, scenario in needed.items() if not is_whole(home / key)}


def _find_bases(scenarios: dict[str, Scenario], drives: Iterable[Scenario], home: Path) -> dict[str, Path]:
    """For each drive to collect, the recording with the same training drive: a finished one, or the first of them."""
    made = {digest_recording(one): one for one in drives} if scenarios else {}
    shared = {_name_training_drive(one): home / key for key, one in made.items() if is_whole(home / key)}
    return {
        key: shared.setdefault(_name_training_drive(one), home / key) if can_share(one.sim) else home / key
        for key, one in scenarios.items()
    }


def _name_training_drive(scenario: Scenario) -> str:
    """A hash that is the same for all recordings with the same training drive."""
    sim = keep_training_settings(scenario.sim)
    return digest_recording(scenario.model_copy(update={"deployment": sim.deployment, "grid": sim.grid}))


def _try_to_derive(drive: Path, scenario: Scenario, folder: Path) -> Failures:
    try:
        derive(drive, scenario.sim, scenario.seed, folder)
    except (InputError, WorkError, OSError) as error:
        return {folder.name: f"recording: {one_line(error)}"}
    return {}
