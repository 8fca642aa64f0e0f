"""The recordings of a study, each drive made once: runs that differ only in encoder, image or length share it.

A drive is collected as its longest recording, with encoders and images as they are by default; each other recording of
it is derived, which takes no simulator, and little room on the disk where the images are the same. One drive follows
another, each made by all cores.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from deepgps.progress import Look, Report
from deepgps.scenario import Scenario, digest_recording
from deepgps.stages import make_recording
from deepgps.studies.engine.worker import Failures
from deepgps.studies.study import Plan
from sim.errors import InputError, WorkError, one_line
from sim.recording.derive import can_be_cut, choose_drive, derive
from sim.recording.format import is_whole


def record_all(plans: Sequence[Plan], missing: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Make the recordings that are missing.

    Args:
        plans: All runs of the study: they tell how long a drive must be.
        missing: Those whose recordings are needed now.
        folder: The study's folder.
        progress: Told how many samples of the drives are driven and drawn, and how many recordings derived.

    Returns:
        Why recordings failed, by their hash.
    """
    drives, home = find_drives(plans), folder / "recordings"
    wanted = _find_wanted(missing, home)
    unmade = _collect_all(_choose_undriven(drives, wanted, home), home, progress)
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
    """What must still be driven, by its hash, for the runs that are missing; the arguments are those of record_all."""
    home = folder / "recordings"
    return _choose_undriven(find_drives(plans), _find_wanted(missing, home), home)


def find_drives(plans: Sequence[Plan]) -> dict[str, Scenario]:
    """What to collect for each recording, by its hash: the longest of its drive, encoders and images without faults."""
    longest: dict[str, int] = {}
    for plan in plans:
        drive = _name_drive(plan.scenario)
        longest[drive] = max(longest.get(drive, 0), plan.scenario.drive.samples)
    return {plan.recording: _choose(plan.scenario, longest[_name_drive(plan.scenario)]) for plan in plans}


def _choose(scenario: Scenario, samples: int) -> Scenario:
    sim = choose_drive(scenario.sim, samples)
    return scenario.model_copy(update={"encoder": sim.encoder, "image_faults": sim.image_faults, "drive": sim.drive})


def _name_drive(scenario: Scenario) -> str:
    """The same for all recordings of a drive."""
    return digest_recording(_choose(scenario, 0 if can_be_cut(scenario.sim) else scenario.drive.samples))


def _find_wanted(missing: Sequence[Plan], home: Path) -> dict[str, Scenario]:
    return {plan.recording: plan.scenario for plan in missing if not is_whole(home / plan.recording)}


def _choose_undriven(drives: dict[str, Scenario], wanted: Iterable[str], home: Path) -> dict[str, Scenario]:
    needed = {digest_recording(drives[key]): drives[key] for key in wanted}
    return {key: scenario for key, scenario in needed.items() if not is_whole(home / key)}


def _collect_all(scenarios: dict[str, Scenario], home: Path, progress: Report) -> Failures:
    total, before, failed = sum(one.drive.samples for one in scenarios.values()), 0, {}
    for key, scenario in scenarios.items():
        part = _half_and_half(progress, before, scenario.drive.samples, total)
        try:
            make_recording(scenario, home / key, part)
        except (InputError, WorkError, OSError) as error:
            failed[key] = f"recording: {one_line(error)}"
        before += scenario.drive.samples
        progress("recordings", before, total)
    return failed


def _try_to_derive(drive: Path, scenario: Scenario, folder: Path) -> Failures:
    try:
        derive(drive, scenario.sim, scenario.seed, folder)
    except (InputError, WorkError, OSError) as error:
        return {folder.name: f"recording: {one_line(error)}"}
    return {}


def _half_and_half(progress: Report, before: int, size: int, total: int) -> Report:
    """One bar of driving and rendering: each counts half of a recording's samples."""
    share: dict[str, float] = {}

    def report(label: str, done: int, of: int, look: Look | None = None) -> None:
        share[label] = done / of
        progress("recordings", before + round(size * sum(share.values()) / 2), total)

    return report
