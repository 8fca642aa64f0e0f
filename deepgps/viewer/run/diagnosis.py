"""The diagnosis of the wheels in the viewer: the page that the command prints."""

from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from deepgps.diagnosis.store import read_diagnosis
from deepgps.reports.wheels_page import write_markdown

ENTITY = "encoders/diagnosis"
NONE = (
    "No diagnosis of the wheels has been made: `deepgps diagnose` makes one, and so do the methods that learn with it, "
    "from a recording with images after turns."
)


def log_diagnosis(stream: rr.RecordingStream, run: Path) -> None:
    """Log the diagnosis in a run's folder, or how to make one."""
    diagnosis = read_diagnosis(run)
    text = NONE if diagnosis is None else write_markdown(diagnosis)
    stream.log(ENTITY, rr.TextDocument(text, media_type="text/markdown"), static=True)


def diagnosis_view() -> rrb.TextDocumentView:
    """The view of it."""
    return rrb.TextDocumentView(name="Diagnosis of the wheels", origin=ENTITY)
