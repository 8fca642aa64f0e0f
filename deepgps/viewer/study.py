"""A study's recording for the Rerun viewer: its error fields, along a timeline for each setting that varies.

Entities: ``world`` (floor plans and error fields, in the world's frame) and ``report`` (text and figures).
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
from deepgps.reports.table import tabulate
from deepgps.runs.run_folder import is_study
from deepgps.studies.study import Study
from deepgps.studies.table import Row, find_methods, read_rows, read_setting, split_by, varied_in
from deepgps.viewer.error_field import NO_PLACES, log_field
from deepgps.viewer.layout import Floor, aim_eye, arrange, pause, room_view, text_view
from deepgps.viewer.scene import log_floor, log_scale
from deepgps.viewer.sliders import RUN, Slider, Step, find_sliders
from deepgps.viewer.stream import hash_files, open_rrd, put, put_text, save_recording
from sim.errors import DamagedError, InputError
from sim.files.checksums import check_lines, check_sum, is_intact
from sim.geometry import limits
from sim.recording.format import open_truth

STUDY = "study.rrd"
FIGURES = {"rms_m": "RMS", "median_m": "median", "p95_m": "p95", "max_m": "max"}
MAX_VALUES = 8
STEPS_PER_SECOND = 1.5


def write_study(folder: Path) -> Path:
    """Write ``<study>/study.rrd``; return its path.

    Equal studies give equal contents: the recording's id is a hash of everything it shows, and no wall-clock time is
    written. Raises InputError if the study has no table yet, or no finished run, or an incomplete one.
    """
    study, rows = read_study(folder)
    identity, path = hash_study(folder, rows), folder / STUDY
    sliders = find_sliders(rows, list(study.axes), own_values(study, varied_in(rows[0])))
    methods, pictures = find_methods(rows), sorted(folder.glob("figures/*.png"))
    spaces = {
        row["run"]: open_truth(folder / "runs" / row["run"] / "recording").free_space
        for row in rows
        if row["failure"] is None
    }
    corners = np.array([limits(space) for space in spaces.values()])
    floor = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    shown: dict[str, list[tuple[Slider, Step, rr.TimeColumn]]] = {}  # Where each run is shown
    for slider in sliders:
        for place, step in enumerate(slider.steps, 1):
            column = rr.TimeColumn(slider.name, sequence=[place])
            shown.setdefault(step.rows[0]["run"], []).append((slider, step, column))

    def log(stream: rr.RecordingStream) -> None:
        put(stream, "world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log_scale(stream, "world/scale", *floor)
        for run, places in shown.items():
            at = [column for _, _, column in places]
            if run in spaces:
                log_floor(stream, spaces[run], at)
            fields = read_all_headings(folder / "runs" / run) if run in spaces else {}
            for method in methods:
                log_field(stream, method, fields.get(method, NO_PLACES), at)
            for slider, step, column in places:
                put_text(stream, "report/here", describe_step(slider, step), [column])
        put_text(stream, "report/sliders", describe_study(study, rows, sliders))
        put_text(stream, "report/table", (folder / "table.md").read_text(encoding="utf-8"))
        for picture in pictures:
            image = rr.EncodedImage(contents=picture.read_bytes(), media_type="image/png")
            put(stream, f"report/figures/{picture.stem}", image)

    blueprint = _make_blueprint(sliders[0].name, methods, [picture.stem for picture in pictures], floor)
    save_recording(path, identity, study.name, blueprint, log)
    return path


def find_study(folder: Path) -> Path:
    """Return a study's recording, written if it is missing, damaged or older than the report; raises InputError."""
    path, report = folder / STUDY, folder / "table.md"
    if not is_intact(path) or (report.is_file() and path.stat().st_mtime < report.stat().st_mtime):
        return write_study(folder)
    open_rrd(path)
    return path


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


def _make_blueprint(timeline: str, methods: Sequence[str], figures: Sequence[str], floor: Floor) -> rrb.Blueprint:
    """The viewer's layout, which opens with a slider and the error fields of all methods side by side."""
    columns = min(len(methods), 2)
    eye = aim_eye(floor, aspect=2.4 / columns)
    fields = [room_view(title_of(name), ["floor_plan", "scale/**", f"error_field/{name}/**"], eye) for name in methods]
    pictures = [rrb.Spatial2DView(name=name.replace("_", " "), origin=f"report/figures/{name}") for name in figures]
    here, guide = text_view("Here", "report/here"), text_view("Sliders", "report/sliders")
    texts = rrb.Vertical(here, guide)
    shown = rrb.Horizontal(rrb.Grid(*fields, grid_columns=columns), texts, column_shares=[5, 2], name="Error fields")
    tabs = [shown, *([rrb.Tabs(*pictures, name="Figures")] if pictures else []), text_view("Report", "report/table")]
    return arrange(tabs, pause(timeline, fps=STEPS_PER_SECOND))


def describe_step(slider: Slider, step: Step) -> str:
    """Describe a slider's place in Markdown: which run is shown, its errors, and the RMS over all seeds."""
    row = step.rows[0]
    blocks = [f"# {slider.name} {step.value}" if slider.name != RUN else f"# {step.value}"]
    if row["failure"] is not None:
        return "\n\n".join([*blocks, f"This run failed: {row['failure']}"])
    blocks.append(f"Run `{row['run']}`: {step.words}.")
    cells = [[title_of(one["method"]), *(write_length(one[name]) for name in FIGURES)] for one in step.rows]
    blocks.append(tabulate(["method", *FIGURES.values()], cells))
    seeds = len({one["run"] for one in step.repeats})
    if seeds > 1:
        errors = {name: [one["rms_m"] for one in group] for name, group in split_by(step.repeats, "method").items()}
        ranges = [
            f"{title_of(one)} {write_length(min(some))} to {write_length(max(some))}" for one, some in errors.items()
        ]
        blocks.append(f"RMS of all {seeds} seeds: {'; '.join(ranges)}.")
    return "\n\n".join(blocks)


def describe_study(study: Study, rows: Sequence[Row], sliders: Sequence[Slider]) -> str:
    """Describe in Markdown what each slider does, and how to read an error field."""
    runs = split_by(rows, "run")
    lines = [f"- **{slider.name}**: {_list_values(slider)}" for slider in sliders]
    first = f"The slider at the bottom moves `{sliders[0].name}`"
    more = "; the list to its left has the others." if len(sliders) > 1 else "."
    reading = (
        "Each arrow points from a true test position to the predicted position, for the worst heading there. All "
        "methods and all positions of a slider share one colour scale. Point at an arrow or a dot: error, heading → "
        "predicted x, y [m]."
    )
    return "\n\n".join(
        [f"# {study.name}: {len(runs)} runs of {study.scenario}", first + more, "\n".join(lines), reading]
    )


def write_length(length_m: float) -> str:
    """Write a length in a suitable unit; less than a micrometre counts as zero."""
    if length_m < 1e-6:
        return "0 mm"
    if length_m < 0.01:
        return f"{1000 * length_m:.2f} mm"
    return f"{100 * length_m:.1f} cm" if length_m < 1 else f"{length_m:.2f} m"


def _list_values(slider: Slider) -> str:
    if slider.name == RUN:
        return f"all {len(slider.steps)} runs, one after another"
    values = [f"`{step.value}`" for step in slider.steps]
    if len(values) > MAX_VALUES:
        values = [*values[: MAX_VALUES - 2], "...", values[-1]]
    others = f" (with {slider.others})" if slider.others else ""
    return f"{', '.join(values)}{others}"
