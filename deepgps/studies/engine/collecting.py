"""Collection of a study's drives, several at once: driving takes one core, and longer than drawing the images."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from deepgps.config.scenario import Scenario
from deepgps.runs.collect import make_recording
from deepgps.studies.engine.pool import Tell, attempt, do_all
from deepgps.studies.engine.worker import Failures
from deepgps.terminal.progress import Look, Report
from sim.processes import usable_cores
from sim.recording.format import is_whole
from sim.recording.training_drive import has_same_training_drive

PER_PROCESS = 1000
"""Samples for which it pays to start one more process that drives."""


@dataclass(frozen=True)
class CollectTask:
    """A drive to collect, perhaps in a worker process. Its size is the number of its samples.

    Attributes:
        scenario: What to collect.
        folder: The recording's folder.
        base: Folder of a recording with the same training drive, which may be its own.
        renderers: Processes that draw; None: as many as pay on all cores.
    """

    scenario: Scenario
    folder: Path
    base: Path
    renderers: int | None

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.scenario.drive.samples

    def __call__(self, tell: Tell) -> None:
        """Collect it, or complete it."""
        given = self.base != self.folder and is_whole(self.base)
        shares = given and has_same_training_drive(self.base, self.scenario.sim, self.scenario.seed)
        report = self._share_out(tell, shares)
        make_recording(self.scenario, self.folder, report, self.base if shares else None, self.renderers)

    def _share_out(self, tell: Tell, shares: bool) -> Report:
        """Report driving and drawing, in training and in use, as one amount in which all stages count the same."""
        stages = (1 if shares else 2) + (2 if self.scenario.deployment.drive_samples else 0)
        share: dict[str, float] = {}

        def report(label: str, done: int, of: int, look: Look | None = None) -> None:
            share[label] = done / of
            tell(round(self.size * sum(share.values()) / stages))

        return report


def collect_all(scenarios: Mapping[str, Scenario], bases: Mapping[str, Path], home: Path, progress: Report) -> Failures:
    """Collect drives; one that shares another's training drive comes after it.

    Args:
        scenarios: What to collect, by the name of its folder.
        bases: Folder of a recording with the same training drive, for each; the first of several is its own.
        home: The folder of all recordings.
        progress: Called with the number of samples collected and their total.

    Returns:
        Reasons why drives failed, by their names.
    """
    first = [key for key in scenarios if bases[key] == home / key or is_whole(bases[key])]
    total, before, failed = sum(one.drive.samples for one in scenarios.values()), 0, Failures()
    for keys in (first, [key for key in scenarios if key not in first]):
        size = sum(scenarios[key].drive.samples for key in keys)
        most = count_drives(len(keys), size)
        drives = {key: _plan(scenarios[key], home / key, bases[key], most) for key in keys}

        def report(done: int, before: int = before) -> None:
            progress("recordings", before + done, total)

        failed |= do_all(drives, most, report) if most > 1 else _collect_in_turn(drives, report)
        before += size
    return {key: f"recording: {reason}" for key, reason in failed.items()}


def _plan(scenario: Scenario, folder: Path, base: Path, at_once: int) -> CollectTask:
    return CollectTask(scenario, folder, base, usable_cores() // at_once if at_once > 1 else None)


def count_drives(drives: int, samples: int) -> int:
    """Number of drives that it pays to collect at once."""
    return max(1, min(usable_cores(), drives, 1 + samples // PER_PROCESS))


def _collect_in_turn(drives: Mapping[str, CollectTask], progress: Tell) -> Failures:
    """Collect drives in this process."""
    failed, before = Failures(), 0
    for key, drive in drives.items():

        def report(done: int, before: int = before, size: int = drive.size) -> None:
            progress(before + min(done, size))

        if reason := attempt(partial(drive, report)):
            failed[key] = reason
        before += drive.size
        progress(before)
    return failed
