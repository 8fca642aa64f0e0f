"""A study's recording for the Rerun viewer: its error fields, along a timeline for each setting that varies.

Entities: ``world`` (floor plan and error fields, in the world's frame, which is moved and scaled so that every room
fills the same rectangle), ``curve`` (errors along each timeline) and ``report`` (text and figures).
"""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from pydantic import ValidationError

from deepgps.config.methods import title_of
from deepgps.config.scenario import load_scenario, read_yaml
from deepgps.config.setting_problems import describe_problems
from deepgps.evaluation.error_field import read_all_headings
from deepgps.runs.run_folder import is_study
from deepgps.studies.catalog import REPORTS
from deepgps.studies.study import Study
from deepgps.studies.table import Row, find_methods, read_rows, read_setting, varied_in
from deepgps.viewer.error_field import NO_PLACES, log_field
from deepgps.viewer.layout import arrange, look, text_view
from deepgps.viewer.plot import plot_view
from deepgps.viewer.read import open_rrd
from deepgps.viewer.scene import STILL_BEHAVIOUR, log_scale
from deepgps.viewer.sliders import Slider, find_sliders
from deepgps.viewer.stream import hash_files, holds, put, put_text, save_recording
from deepgps.viewer.study_scene import (
    CURVES,
    Frame,
    describe_step,
    describe_study,
    find_frame,
    log_curves,
    log_heading,
    log_rooms,
    slider_row,
)
from sim.errors import DamagedError, InputError
from sim.files.checksums import check_lines, check_sum, is_intact, read_arrays
from sim.recording.format import open_truth

STUDY = "study.rrd"
MAX_ARROWS = 2_500_000  # about 75 MB; in larger studies, every field is thinned out
MAX_PLACES = 2_000  # of one slider, about 10 kB each in addition to their arrows
STEPS_PER_SECOND = 1.5


def write_study(folder: Path) -> Path:
    """Write ``<study>/study.rrd`` unless it exists and is up to date; return its path.

    Equal studies give equal contents: the recording's id is a hash of everything it shows, and no wall-clock time is
    written. Raises InputError if the study has no table yet, or no finished run, or an incomplete one.
    """
    study, rows = read_study(folder)
    path, identity = folder / STUDY, hash_study(folder, rows)
    if not holds(path, identity):
        _write(folder, study, rows, identity)
    return path


def find_study(folder: Path) -> Path:
    """Return a study's recording, written if it is missing, damaged or older than the report; raises InputError."""
    path, report = folder / STUDY, folder / "table.md"
    if not is_intact(path) or (report.is_file() and path.stat().st_mtime < report.stat().st_mtime):
        return write_study(folder)
    open_rrd(path)
    return path


def _write(folder: Path, study: Study, rows: Sequence[Row], identity: str) -> None:
    done = {row["run"]: row for row in rows if row["failure"] is None}
    spaces = {row["recording"]: open_truth(folder / "runs" / run / "recording").free_space for run, row in done.items()}
    found = find_sliders(rows, list(study.axes), own_values(study, varied_in(rows[0])))
    sliders = [slider for slider in found if len(slider.steps) <= MAX_PLACES] or found[:1]
    left_out = [slider.name for slider in found if slider not in sliders]
    methods, frame, every = find_methods(rows), find_frame(spaces), _thin(folder, sliders)
    pictures = sorted(folder.glob("figures/*.png"))

    def log(stream: rr.RecordingStream) -> None:
        put(stream, "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log_scale(stream, "scale", *frame)
        for slider in sliders:
            log_rooms(stream, slider, spaces, frame)
            for place, step in zip(slider.places, slider.steps, strict=True):
                at = slider_row(slider, place)
                fields = read_all_headings(folder / "runs" / step.rows[0]["run"]) if step.done else {}
                for method in methods:
                    log_field(stream, method, fields.get(method, NO_PLACES).take(slice(None, None, every)), at)
                    log_heading(stream, method, slider, step, frame, at)
                put_text(stream, "report/here", describe_step(slider, step), at)
            log_curves(stream, slider)
        put_text(stream, "report/sliders", describe_study(study, rows, sliders, left_out, every))
        put_text(stream, "report/table", (folder / "table.md").read_text(encoding="utf-8"))
        for path in pictures:
            image = rr.EncodedImage(contents=path.read_bytes(), media_type="image/png")
            put(stream, f"report/figures/{path.stem}", image)

    blueprint = _make_blueprint(sliders[0], methods, [path.stem for path in pictures], frame)
    save_recording(folder / STUDY, identity, study.name, blueprint, log)


def _thin(folder: Path, sliders: Sequence[Slider]) -> int:
    """Stride of the test positions that are shown, so that the file stays small."""
    arrows = 0
    for step in (step for slider in sliders for step in slider.steps if step.done):
        truth = read_arrays(folder / "runs" / step.rows[0]["run"] / "error_field.npz")["truth"]
        arrows += len(step.rows) * len(truth)  # one for each method and test position
    return max(1, -(-arrows // MAX_ARROWS))


def read_study(folder: Path) -> tuple[Study, list[Row]]:
    """Read a study and its table; raise InputError if the study is unfinished, broken, or has no finished run."""
    path = folder / "table.parquet"
    if not is_study(folder) or not path.is_file():
        lack = "table.parquet" if is_study(folder) else "study.yaml"
        raise InputError(f"{folder} is not a finished study: it has no {lack} (deepgps study writes it)")
    try:
        check_lines(folder / "study.yaml")
        check_sum(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; run deepgps study with the same study and --out to write it again") from None
    try:
        study = Study.model_validate(read_yaml(folder / "study.yaml"))
    except ValidationError as error:
        raise InputError(f"{folder / 'study.yaml'}: {describe_problems(error, Study)}") from None
    if REPORTS[study.report].gather:
        raise InputError(f"{folder} is a study without maps to view; its page is {folder / 'table.md'}")
    try:
        rows = read_rows(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
    if not rows or not {"run", "recording", "seed", "samples", "method", "failure"} <= set(rows[0]):
        raise InputError(f"{path} is not a study's table")
    if not any(row["failure"] is None for row in rows):
        raise InputError(f"{folder} has no finished run; see its table.md for the reasons")
    return study, rows


def own_values(study: Study, names: Sequence[str]) -> dict[str, object]:
    """The scenario's own values of the settings that vary; empty if its file is gone or of another version."""
    with suppress(InputError, AttributeError):
        scenario = load_scenario(study.scenario, study.set)
        return {name: read_setting(scenario, name) for name in names}
    return {}


def hash_study(folder: Path, rows: Sequence[Row]) -> str:
    """Thirty-two hexadecimal digits of a study's table, figures, error fields and recordings."""
    runs = dict.fromkeys(folder / "runs" / row["run"] for row in rows if row["failure"] is None)
    names = ("study.yaml", "table.parquet", "table.md")
    shown = [*(folder / name for name in names), *sorted(folder.glob("figures/*.png"))]
    shown += [run / name for name in ("error_field.npz", "recording/manifest.json") for run in runs]
    for path in shown:
        if not path.is_file():
            raise InputError(f"{folder} is an incomplete study: {path.relative_to(folder)} is missing")
    return hash_files(folder, shown)


def _make_blueprint(slider: Slider, methods: Sequence[str], figures: Sequence[str], frame: Frame) -> rrb.Blueprint:
    """The viewer's layout, which opens with a slider and the error fields of all methods side by side."""
    pictures = [rrb.Spatial2DView(name=name.replace("_", " "), origin=f"report/figures/{name}") for name in figures]
    fields = rrb.Grid(*_field_views(methods, frame), grid_columns=1 if len(methods) == 1 else 2)
    shown = rrb.Vertical(fields, rrb.Horizontal(*_plots()), row_shares=[5, 2])
    texts = rrb.Vertical(_here(), text_view("Sliders", "report/sliders"))
    tabs = {
        "Error fields": (shown, texts),
        "Curves": (rrb.Vertical(*_plots()), _here()),
        **({"Figures": (rrb.Tabs(*pictures), _here())} if figures else {}),
        "Report": (text_view("Table", "report/table"), _here()),
    }
    apart = float(np.ptp(slider.places)) / max(len(slider.steps) - 1, 1)
    fps = STEPS_PER_SECOND * max(apart, 1.0)
    return arrange(
        [rrb.Horizontal(*pair, column_shares=[5, 2], name=name) for name, pair in tabs.items()],
        rrb.TimePanel(state="collapsed", timeline=slider.timeline, fps=fps, play_state="paused"),
    )


def _here() -> rrb.TextDocumentView:
    return text_view("Here", "report/here")


def _plots() -> list[rrb.Spatial2DView]:
    return [plot_view(f"{title} along the slider [cm]", f"curve/{name}") for name, title in CURVES.items()]


def _field_views(methods: Sequence[str], frame: Frame) -> list[rrb.Spatial3DView]:
    """Views of the error fields from above, of the frame with its heading and its scale."""
    width, depth = frame[1] - frame[0]
    seen = max(depth + 2.2, 1.1 * width / (1.5 if len(methods) != 2 else 0.83))
    distance = seen / (2 * np.tan(np.radians(55 / 2)))  # the viewer's field of view is 55 degrees
    backdrop = ("world/floor_plan", "world/outline", "world/metre", "scale")
    return [
        rrb.Spatial3DView(
            name=title_of(method),
            origin="/",
            contents=[
                *("world/floor_plan", "world/outline", "world/metre/**", "scale/**"),
                *(f"world/error_field/{method}/**", f"heading/{method}"),
            ],
            eye_controls=look((0.0, 0.0, distance), (0.0, 0.0, 0.0)),
            line_grid=False,
            overrides=dict.fromkeys(backdrop, STILL_BEHAVIOUR),
        )
        for method in methods
    ]
