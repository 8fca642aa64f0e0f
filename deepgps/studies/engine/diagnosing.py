"""The runs of a study that diagnoses recordings and trains nothing."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from deepgps.diagnosis.diagnosis import diagnose
from deepgps.diagnosis.store import FILE, read_diagnosis, write_diagnosis
from deepgps.diagnosis.turning import Sight
from deepgps.studies.engine.pool import Tell, attempt, do_all
from deepgps.studies.engine.worker import Failures
from deepgps.studies.plan import Plan
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.processes import usable_cores
from sim.recording.format import open_recording, read_manifest


@dataclass(frozen=True)
class SameImages:
    """Recordings of the same images to diagnose in a worker process: the angles that the camera sees are found once.

    Attributes:
        runs: Folder of each run, which gets a ``diagnosis.json``.
        recordings: Folder of each run's recording.
    """

    runs: Sequence[Path]
    recordings: Sequence[Path]

    @property
    def size(self) -> int:
        """Number of runs."""
        return len(self.runs)

    def __call__(self, tell: Tell) -> str | None:
        """Diagnose them in order; returns a line for each run that failed, with its name and the reason, or None."""
        sight, lines = Sight(), []
        for done, (run, folder) in enumerate(zip(self.runs, self.recordings, strict=True), start=1):
            if reason := attempt(partial(_diagnose, run, folder, sight)):
                lines.append(f"{run.name} {reason}")
            tell(done)
        return "\n".join(lines) or None


def diagnose_all(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Diagnose the recordings of runs and write ``runs/<run>/diagnosis.json``.

    Args:
        plans: The runs.
        folder: The study's folder.
        progress: Called with the number of runs done and their total.

    Returns:
        Reasons why runs failed, by the hash of the run.
    """
    groups: dict[str, list[Plan]] = {}
    for plan in plans:
        groups.setdefault(_name_images(folder / "recordings" / plan.recording), []).append(plan)
    tasks = {images: _plan(group, folder) for images, group in groups.items()}
    failed = do_all(tasks, usable_cores(), lambda done: progress("diagnose", done, len(plans)))
    return {
        plan.run: _find_reason(text, plan.run)
        for images, text in failed.items()
        for plan in groups[images]
        if read_diagnosis(folder / "runs" / plan.run) is None
    }


def _diagnose(run: Path, folder: Path, sight: Sight) -> None:
    recording = open_recording(folder)
    run.mkdir(parents=True, exist_ok=True)
    write_diagnosis(run / FILE, diagnose(recording, sight), recording)


def _find_reason(text: str, run: str) -> str:
    """Why a run failed, by what its task returned; if its process died, that is the reason of all its runs."""
    reasons = dict(line.split(" ", 1) for line in text.splitlines())
    return reasons.get(run, text)


def _name_images(folder: Path) -> str:
    """Checksums of a recording's images; its folder, if it cannot be read."""
    try:
        files = read_manifest(folder).sha256
    except (InputError, OSError):
        return str(folder)
    return " ".join(files[name] for name in sorted(files) if name.startswith("observations/"))


def _plan(group: Sequence[Plan], folder: Path) -> SameImages:
    runs = [folder / "runs" / plan.run for plan in group]
    return SameImages(runs, [folder / "recordings" / plan.recording for plan in group])
