"""The recordings of a study: runs that differ only in encoders, image faults or length share one drive.

A drive is collected once, at its greatest length and with the default encoders and images. All other recordings of the
drive are derived from it, which needs no simulator, and little disk space where the images are the same. Drives that
differ in deployment or test grid share all but their tests. Several drives are collected at once: driving takes one
core, and longer than drawing the images.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from deepgps.config.scenario import Scenario
from deepgps.methods.train import make_judge
from deepgps.runs.collect import make_recording
from deepgps.runs.inputs import digest_recording
from deepgps.studies.engine.pool import Failures, Tell, attempt, do_all
from deepgps.studies.plan import Plan
from deepgps.terminal.progress import Look, Report
from sim.processes import usable_cores
from sim.recording.derive import (
    can_be_cut,
    can_share,
    choose_drive,
    derive,
    has_same_training_drive,
    keep_training_settings,
)
from sim.recording.format import is_whole

SAMPLES_PER_PROCESS = 1000  # Samples for which it pays to start one more process that drives


@dataclass(frozen=True)
class CollectTask:
    """A drive to collect, perhaps in a worker process. Its size is the number of its samples."""

    scenario: Scenario  # What to collect
    folder: Path  # The recording's folder
    base: Path  # Folder of a recording with the same training drive, which may be its own
    renderers: int | None  # Processes that draw; None: as many as pay on all cores

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.scenario.drive.samples

    def __call__(self, tell: Tell) -> None:
        """Collect it, or complete it."""
        given = self.base != self.folder and is_whole(self.base)
        shares = given and has_same_training_drive(self.base, self.scenario.sim, self.scenario.seed)
        report = self._share_out(tell, shares)
        with TemporaryDirectory() as learned:
            judge = make_judge(self.scenario, Path(learned))
            make_recording(self.scenario, self.folder, report, self.base if shares else None, self.renderers, judge)

    def _share_out(self, tell: Tell, shares: bool) -> Report:
        """Report driving and drawing, in training and deployment, as one amount in which all stages count the same."""
        stages = (1 if shares else 2) + (2 if self.scenario.deployment.drive_samples else 0)
        share: dict[str, float] = {}

        def report(label: str, done: int, of: int, look: Look | None = None) -> None:
            share[label] = done / of
            tell(round(self.size * sum(share.values()) / stages))

        return report


def record_all(plans: Sequence[Plan], missing: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Make the recordings of the missing runs; all runs of the study determine how long each drive must be.

    Returns the reasons why recordings failed, by the hash of the recording.
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
            reason = attempt(partial(derive, home / drive, scenario.sim, scenario.seed, home / key))
            failed |= {key: f"recording: {reason}"} if reason else {}
        progress("derived", done, len(wanted))
    return failed


def list_undriven(plans: Sequence[Plan], missing: Sequence[Plan], folder: Path) -> list[Scenario]:
    """Scenarios of drives still to collect for the missing runs; takes the arguments of ``record_all``."""
    home = folder / "recordings"
    return list(_choose_undriven(find_drives(plans), _find_wanted(missing, home), home).values())


def find_drives(plans: Sequence[Plan]) -> dict[str, Scenario]:
    """What to collect for each recording, by its hash: its drive at the greatest length, without any faults."""
    longest: dict[str, int] = {}
    for plan in plans:
        drive = _name_drive(plan.scenario)
        longest[drive] = max(longest.get(drive, 0), plan.scenario.drive.samples)
    return {plan.recording: _choose(plan.scenario, longest[_name_drive(plan.scenario)]) for plan in plans}


def collect_all(scenarios: Mapping[str, Scenario], bases: Mapping[str, Path], home: Path, progress: Report) -> Failures:
    """Collect drives by the names of their folders; one that shares another's training drive comes after it.

    Each has the folder of a recording with the same training drive, the first of several its own. Returns the reasons
    why drives failed, by their names.
    """
    first = [key for key in scenarios if bases[key] == home / key or is_whole(bases[key])]
    total, before, failed = sum(one.drive.samples for one in scenarios.values()), 0, Failures()
    for keys in (first, [key for key in scenarios if key not in first]):
        size = sum(scenarios[key].drive.samples for key in keys)
        most = count_drives(len(keys), size)
        renderers = usable_cores() // most if most > 1 else None
        drives = {key: CollectTask(scenarios[key], home / key, bases[key], renderers) for key in keys}
        report = partial(lambda done, before: progress("recordings", before + done, total), before=before)
        failed |= do_all(drives, most, report) if most > 1 else _collect_in_turn(drives, report)
        before += size
    return {key: f"recording: {reason}" for key, reason in failed.items()}


def count_drives(drives: int, samples: int) -> int:
    """Number of drives that it pays to collect at once."""
    return max(1, min(usable_cores(), drives, 1 + samples // SAMPLES_PER_PROCESS))


def _choose(scenario: Scenario, samples: int) -> Scenario:
    return scenario.model_copy(update=dict(choose_drive(scenario.sim, samples)))


def _name_drive(scenario: Scenario) -> str:
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
    return digest_recording(scenario.model_copy(update=dict(keep_training_settings(scenario.sim))))


def _collect_in_turn(drives: Mapping[str, CollectTask], progress: Tell) -> Failures:
    failed, before = Failures(), 0
    for key, drive in drives.items():
        tell = partial(lambda done, size, before: progress(before + min(done, size)), size=drive.size, before=before)
        progress(before)
        if reason := attempt(partial(drive, tell)):
            failed[key] = reason
        before += drive.size
        progress(before)
    return failed
