"""A study's recording for the Rerun viewer: its error fields, along a timeline for each setting that varies.

Entities: ``world`` (floor plan and error fields, in the world's frame, which is moved and scaled so that every room
fills the same rectangle), ``curve`` (errors along each timeline) and ``report`` (text and figures).
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import product
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
from deepgps.reports.plots import colour_on_dark
from deepgps.reports.table import tabulate
from deepgps.runs.run_folder import is_study
from deepgps.studies.catalog import REPORTS
from deepgps.studies.study import Study
from deepgps.studies.table import Row, find_methods, read_rows, read_setting, split_by, varied_in
from deepgps.viewer.error_field import NO_PLACES, log_field
from deepgps.viewer.layout import LOGARITHM, NIGHT, arrange, look, series_view, text_view
from deepgps.viewer.read import open_rrd
from deepgps.viewer.scene import STILL_BEHAVIOUR, lift, log_floor, log_scale
from deepgps.viewer.sliders import RUN, Slider, Step, find_sliders
from deepgps.viewer.stream import Rows, hash_files, holds, put, put_text, save_recording
from sim.errors import DamagedError, InputError
from sim.files.checksums import check_lines, check_sum, is_intact, read_arrays
from sim.geometry import FreeSpace, limits
from sim.recording.format import open_truth

STUDY = "study.rrd"
Frame = tuple[np.ndarray, np.ndarray]  # south-west and north-east corners (2,) [m] of the rectangle for every room
Spaces = Mapping[str, FreeSpace]  # by the name of the recording
CURVES = {"rms": "RMS", "median": "Median"}
FIGURES = {"rms_m": "RMS", "median_m": "median", "p95_m": "p95", "max_m": "max"}
FRAME_M = 4.5  # depth of the rectangle that rooms are drawn in, chosen to suit the size of the text
MAX_VALUES = 8
MIN_ERROR_CM, PALE_OPACITY = 1e-4, 110  # Least error that is drawn; opacity of the best and the worst seed
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
    curves = [series_view(f"{title} along the slider: {LOGARITHM}", f"curve/{name}") for name, title in CURVES.items()]
    shown = rrb.Vertical(fields, rrb.Horizontal(*curves), row_shares=[5, 2])
    texts = rrb.Vertical(_here(), text_view("Sliders", "report/sliders"))
    tabs = {
        "Error fields": (shown, texts),
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
            background=NIGHT,
            overrides=dict.fromkeys(backdrop, STILL_BEHAVIOUR),
        )
        for method in methods
    ]


def slider_row(slider: Slider, place: int) -> Rows:
    """The row at a place of a slider."""
    return [rr.TimeColumn(slider.timeline, sequence=[place])]


def find_frame(spaces: Spaces) -> Frame:
    """Corners (2,) [m] of a rectangle around the origin in the proportions of the widest and the deepest room."""
    size = np.max([high - low for low, high in map(limits, spaces.values())], axis=0)
    size *= FRAME_M / max(size[1], 0.62 * size[0])
    return -size / 2, size / 2


def log_rooms(stream: rr.RecordingStream, slider: Slider, spaces: Spaces, frame: Frame) -> None:
    """Log the floor plan where it changes along a slider, scaled into the frame, and a scale bar of known length."""
    shown, grey = None, [200, 206, 216]
    for place, step in zip(slider.places, slider.steps, strict=True):
        space = spaces[step.rows[0]["recording"]] if step.done else None
        if space is None or (shown is not None and _is_same(space, shown)):
            continue
        shown, at = space, slider_row(slider, place)
        low, high = limits(space)
        scale = float(np.min((frame[1] - frame[0]) / (high - low)))
        put(stream, "world", rr.Transform3D(translation=[*(-scale * (low + high) / 2), 0.0], scale=scale), at)
        log_floor(stream, space, at)
        length = _round_length((high[0] - low[0]) / 4)
        start = np.array([low[0], high[1] + 0.15 / scale])
        bar = lift(start + np.array([[0, 0], [length, 0]]), 0.0)
        put(stream, "world/metre", rr.LineStrips3D([bar], radii=0.012 / scale, colors=grey), at)
        label = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
        beside = bar[1:] + np.array([0.4, 0.18, 0]) / scale  # a label is drawn below its point
        name = rr.Points3D(beside, radii=0.0, colors=grey, labels=[label], show_labels=True)
        put(stream, "world/metre/length", name, at)


def log_heading(stream: rr.RecordingStream, method: str, slider: Slider, step: Step, frame: Frame, at: Rows) -> None:
    """Log the slider's place and the size of the errors above a method's error field."""
    place = [[(frame[0][0] + frame[1][0]) / 2, frame[1][1] + 1.15, 0.0]]
    text, colour = describe_field(method, slider, step), colour_on_dark(method)
    label = rr.Points3D(place, radii=0.0, colors=colour, labels=[text], show_labels=True)
    put(stream, f"heading/{method}", label, at)


def log_curves(stream: rr.RecordingStream, slider: Slider) -> None:
    """Log each method's errors along a slider: the mean over seeds, and if there are several the best and the worst.

    The viewer's plots have no logarithmic axis: values are decimal logarithms of centimetres.
    """
    places = list(zip(slider.places, slider.steps, strict=True))
    for name, method in product(CURVES, find_methods(row for _, step in places for row in step.repeats)):
        found = {
            place: [max(100 * row[f"{name}_m"], MIN_ERROR_CM) for row in step.repeats if row["method"] == method]
            for place, step in places
        }
        found = {place: errors for place, errors in found.items() if errors}
        values = np.log10([[np.mean(errors), min(errors), max(errors)] for errors in found.values()])
        path, colour = f"curve/{name}/{method}", colour_on_dark(method)
        colours, names = [colour, *2 * [(*colour, PALE_OPACITY)]], [title_of(method), "best seed", "worst seed"]
        stream.log(path, rr.SeriesLines(colors=colours, names=names, widths=[2.5, 1.0, 1.0]), static=True)
        at, rows = rr.TimeColumn(slider.timeline, sequence=list(found)), rr.Scalars.columns(scalars=values.ravel())
        stream.send_columns(path, [at], rows.partition([3] * len(found)))


def _round_length(most: float) -> float:
    """The longest length of at most ``most`` [m] that is 1, 2 or 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(most))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= most))


def _is_same(one: FreeSpace, other: FreeSpace) -> bool:
    same = one.cell_m == other.cell_m and np.array_equal(one.origin, other.origin)
    return same and np.array_equal(one.free, other.free) and np.array_equal(one.reachable, other.reachable)


def describe_field(method: str, slider: Slider, step: Step) -> str:
    """The lines above a method's error field."""
    where = step.value if slider.name == RUN else f"{slider.name} {step.value}"
    row = next((row for row in step.rows if row["method"] == method), None)
    if row is None:
        return f"{where}\nno {title_of(method)}"
    if row["failure"] is not None:
        return f"{where}\nfailed"
    return f"{where}\nRMS {write_length(row['rms_m'])}, median {write_length(row['median_m'])}"


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


def describe_study(
    study: Study, rows: Sequence[Row], sliders: Sequence[Slider], left_out: Sequence[str], every: int
) -> str:
    """Describe in Markdown what each slider does, and how to read an error field."""
    runs = split_by(rows, "run")
    lines = [f"- **{slider.name}**: {_list_values(slider)}" for slider in sliders]
    first = f"The slider at the bottom moves `{sliders[0].name}`"
    more = "; the list to its left has the others." if len(sliders) > 1 else "."
    reading = (
        "Each arrow points from a true test position to the predicted position, for the worst heading there. All "
        "methods and all positions of a slider share one colour scale. Every room is scaled to fill the same "
        "rectangle; the bar above it shows its scale. Point at an arrow or a dot: error, heading → predicted x, y [m]. "
        "The numbers on a slider are the setting's values, in the unit in brackets after its name."
    )
    notes = [f"Left out because it has too many positions: {name}." for name in left_out]
    notes += [f"Only one in {every} test positions is drawn, to keep the file small."] if every > 1 else []
    return "\n\n".join(
        [f"# {study.name}: {len(runs)} runs of {study.scenario}", first + more, "\n".join(lines), reading, *notes]
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
    count = f"{len(slider.steps)} positions, " if "..." in values else ""
    others = f" (with {slider.others})" if slider.others else ""
    return f"{count}{', '.join(values)}{others}"
