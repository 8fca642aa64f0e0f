"""The runs of a study that diagnoses recordings and trains nothing."""

from collections.abc import Sequence
from pathlib import Path

from deepgps.diagnosis.diagnosis import diagnose
from deepgps.diagnosis.sight import Sight
from deepgps.diagnosis.store import FILE, write_diagnosis
from deepgps.progress import Report
from deepgps.studies.engine.worker import Failures
from deepgps.studies.study import Plan
from sim.errors import InputError, WorkError, one_line
from sim.recording.format import open_recording


def diagnose_all(plans: Sequence[Plan], folder: Path, progress: Report) -> Failures:
    """Diagnose the recordings of runs and write ``runs/<run>/diagnosis.json``.

    Recordings of the same images share the angles that the camera sees, each of which is found once.

    Args:
        plans: The runs.
        folder: The study's folder.
        progress: Called with the number of runs done and their total.

    Returns:
        Reasons why runs failed, by the hash of the run.
    """
    sights: dict[str, Sight] = {}
    failures: Failures = {}
    for done, plan in enumerate(plans, start=1):
        try:
            recording = open_recording(folder / "recordings" / plan.recording)
            files = recording.manifest.sha256
            images = " ".join(files[name] for name in sorted(files) if name.startswith("observations/"))
            diagnosis = diagnose(recording, sights.setdefault(images, Sight()))
            (folder / "runs" / plan.run).mkdir(parents=True, exist_ok=True)
            write_diagnosis(folder / "runs" / plan.run / FILE, diagnosis, recording)
        except (InputError, WorkError, OSError) as error:
            failures[plan.run] = one_line(error)
        progress("diagnose", done, len(plans))
    return failures
