"""A study's recording for the Rerun viewer: its error fields, along a timeline for each setting that varies.

Entities: ``world`` (floor plan and error fields, in the world's frame, which is moved and scaled so that every room
fills the same rectangle), ``curve`` (errors along each timeline) and ``report`` (text and figures).
"""

from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from deepgps.studies.study import Study
from deepgps.studies.table import Row, find_methods, varied_in
from deepgps.viewer.error_field import NO_PLACES, log_field
from deepgps.viewer.read import open_rrd
from deepgps.viewer.save import holds, save_recording
from deepgps.viewer.scene import Places, log_scale_below, put
from deepgps.viewer.study import text as study_text
from deepgps.viewer.study.layout import make_blueprint
from deepgps.viewer.study.read import count_arrows, hash_study, open_space, own_values, read_step, read_study
from deepgps.viewer.study.scene import find_frame, log_curves, log_heading, log_rooms
from deepgps.viewer.study.sliders import Slider, find_sliders
from sim.files.checksums import is_intact

STUDY = "study.rrd"
MOST_ARROWS = 2_500_000  # about 75 MB; in larger studies, every field is thinned out
MOST_PLACES = 2_000  # of one slider, about 10 kB each in addition to their arrows


def write_study(folder: Path) -> Path:
    """Write ``<study>/study.rrd`` unless it exists and is up to date; return its path.

    Equal studies give equal contents: the recording's id is a hash of everything it shows, and no wall-clock time is
    written.

    Raises:
        InputError: The study has no table yet, or no finished run, or an incomplete one.
    """
    study, rows = read_study(folder)
    path, identity = folder / STUDY, hash_study(folder, rows)
    if not holds(path, identity):
        _write(folder, study, rows, identity)
    return path


def find_study(folder: Path) -> Path:
    """Return a study's recording, written if it is missing, damaged or older than the report.

    Raises:
        InputError: It cannot be read.
    """
    path, report = folder / STUDY, folder / "table.md"
    if not is_intact(path) or (report.is_file() and path.stat().st_mtime < report.stat().st_mtime):
        return write_study(folder)
    open_rrd(path)
    return path


def _write(folder: Path, study: Study, rows: Sequence[Row], identity: str) -> None:
    done = {row["run"]: row for row in rows if row["failure"] is None}
    spaces = {row["recording"]: open_space(folder, row) for row in done.values()}
    found = find_sliders(rows, list(study.axes), own_values(study, varied_in(rows[0])))
    sliders = [slider for slider in found if len(slider.steps) <= MOST_PLACES] or found[:1]
    left_out = [slider.name for slider in found if slider not in sliders]
    methods = find_methods(rows)
    frame, every = find_frame(spaces), _thin(folder, sliders)
    pictures = sorted(folder.glob("figures/*.png"))

    def log(stream: rr.RecordingStream) -> None:
        put(stream, "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log_scale_below(stream, "scale", *frame)
        for slider in sliders:
            log_rooms(stream, slider, spaces, frame)
            for place, step in zip(slider.places, slider.steps, strict=True):
                at = [rr.TimeColumn(slider.timeline, sequence=[place])]
                fields = read_step(folder, step) if step.done else {}
                for method in methods:
                    log_field(stream, method, fields.get(method, NO_PLACES).take(slice(None, None, every)), at)
                    log_heading(stream, method, slider, step, frame, at)
                _log_text(stream, "here", study_text.describe_step(slider, step), at)
            log_curves(stream, slider)
        _log_text(stream, "sliders", study_text.describe_study(study, rows, sliders, left_out, every))
        _log_text(stream, "table", (folder / "table.md").read_text(encoding="utf-8"))
        for path in pictures:
            image = rr.EncodedImage(contents=path.read_bytes(), media_type="image/png")
            put(stream, f"report/figures/{path.stem}", image)

    blueprint = make_blueprint(sliders[0], methods, [path.stem for path in pictures], frame)
    save_recording(folder / STUDY, identity, study.name, blueprint, log)


def _log_text(stream: rr.RecordingStream, name: str, text: str, at: Places = ()) -> None:
    put(stream, f"report/{name}", rr.TextDocument(text, media_type="text/markdown"), at)


def _thin(folder: Path, sliders: Sequence[Slider]) -> int:
    """Stride of the test positions that are shown, so that the file stays small."""
    steps = [step for slider in sliders for step in slider.steps if step.done]
    arrows = sum(count_arrows(folder, step) for step in steps)
    return max(1, -(-arrows // MOST_ARROWS))
