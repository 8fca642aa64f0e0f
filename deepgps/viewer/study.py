"""A study's recording for the Rerun viewer: its error fields, along a timeline for each thing that varies in it.

Entities: ``world`` (floor plan and error fields, in the world's frame, which is moved and scaled so that every room
fills the same rectangle), ``curve`` (errors along each timeline) and ``report`` (text and figures).
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rerun as rr
from matplotlib.colors import to_rgb
from pydantic import ValidationError

from deepgps import figures
from deepgps.figures import WorstField, read_fields
from deepgps.report import method_title
from deepgps.scenario import describe_problems, load_scenario, read_yaml
from deepgps.studies.study import Study
from deepgps.studies.table import Row, mean, read_setting, varied_in
from deepgps.viewer import study_text
from deepgps.viewer.read import open_rrd
from deepgps.viewer.recording import APPLICATION
from deepgps.viewer.scene import lift, log_field, log_floor, log_scale_below, put
from deepgps.viewer.sliders import Slider, Step, find_sliders
from deepgps.viewer.study_layout import CURVES, make_blueprint
from sim.errors import InputError
from sim.files import write_atomic
from sim.records import FreeSpace, open_truth, sha256

STUDY = "study.rrd"
FRAME_M = 4.5  # depth of the rectangle that rooms are drawn in; text beside it wants this much
MOST_ARROWS = 2_500_000  # some 110 MB; in a larger study every field is thinned
MOST_PLACES = 2_000  # of one slider, some 10 kB each besides their arrows
NOTHING = WorstField(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
Take = Callable[[Sequence[Row], str], float]
Spaces = Mapping[str, FreeSpace]  # by the name of the recording


def is_study(folder: Path) -> bool:
    """Whether a folder is a study's."""
    return (folder / "study.yaml").is_file()


def write_study(folder: Path) -> Path:
    """Write ``<study>/study.rrd`` unless it stands and nothing changed since; returns its path.

    Equal studies give equal contents: the recording's id is a hash of all that it shows, and no wall-clock time is
    written.

    Raises:
        InputError: The study has no table yet, or no run that is done, or one that is not whole.
    """
    study, rows = read_study(folder)
    path, identity = folder / STUDY, _hash(folder, rows)
    if not _holds(path, identity):
        write_atomic(path, lambda part: _write(part, folder, study, rows, identity))
    return path


def find_study(folder: Path) -> Path:
    """A study's recording, written if it is missing and checked to be whole; raises InputError."""
    path = folder / STUDY
    if not path.is_file():
        return write_study(folder)
    open_rrd(path)
    return path


def read_study(folder: Path) -> tuple[Study, list[Row]]:
    """A study and its table; raises InputError where it is not finished, broken, or has no run that is done."""
    path = folder / "table.parquet"
    if not is_study(folder) or not path.is_file():
        lack = "table.parquet" if is_study(folder) else "study.yaml"
        raise InputError(f"{folder} is no finished study: it has no {lack} (deepgps study writes it)")
    try:
        study = Study.model_validate(read_yaml(folder / "study.yaml"))
    except ValidationError as error:
        raise InputError(f"{folder / 'study.yaml'}: {describe_problems(error, Study)}") from None
    try:
        rows = pq.read_table(path).to_pylist()
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
    if not any(row["failure"] is None for row in rows):
        raise InputError(f"{folder} has no run that is done; its table.md says why")
    return study, rows


def _write(part: Path, folder: Path, study: Study, rows: Sequence[Row], identity: str) -> None:
    done = {row["run"]: row for row in rows if row["failure"] is None}
    spaces = {row["recording"]: _open_space(folder, row) for row in done.values()}
    found = find_sliders(rows, list(study.axes), _own_values(study, varied_in(rows[0])))
    sliders = [slider for slider in found if len(slider.steps) <= MOST_PLACES] or found[:1]
    left_out = [slider.name for slider in found if slider not in sliders]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    frame, every = _find_frame(spaces), _thin(folder, sliders)
    pictures = sorted(folder.glob("figures/*.png"))
    blueprint = make_blueprint(sliders[0].name, methods, [path.stem for path in pictures], frame)
    # Chunks end by size and never by the clock, as in a run's recording.
    by_size = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))
    # The viewer keeps one layout for an application: a study's is its own.
    application = f"{APPLICATION}-study-{identity}"
    stream = rr.RecordingStream(application, recording_id=identity, send_properties=False, batcher_config=by_size)
    with stream:
        stream.save(part, default_blueprint=blueprint)
        stream.send_recording_name(study.name)
        put(stream, "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log_scale_below(stream, "scale", *frame)
        for slider in sliders:
            _log_rooms(stream, slider, spaces, frame)
            for index, step in enumerate(slider.steps):
                at = [rr.TimeColumn(slider.name, sequence=[index])]
                fields = _read(folder, step) if step.done else {}
                for method in methods:
                    log_field(stream, method, _keep(fields.get(method, NOTHING), every), at)
                    _log_heading(stream, method, slider, step, frame, at)
                _log_text(stream, "here", study_text.describe_step(slider, step), at)
            _log_curves(stream, slider)
        _log_text(stream, "sliders", study_text.describe_study(study, rows, sliders, left_out, every))
        _log_text(stream, "table", (folder / "table.md").read_text(encoding="utf-8"))
        for path in pictures:
            image = rr.EncodedImage(contents=path.read_bytes(), media_type="image/png")
            put(stream, f"report/figures/{path.stem}", image)
        stream.flush()
        stream.disconnect()


def _log_rooms(
    stream: rr.RecordingStream, slider: Slider, spaces: Spaces, frame: tuple[np.ndarray, np.ndarray]
) -> None:
    """The floor plan wherever it changes along a slider, moved and scaled into the frame, and a bar of known length."""
    shown = None
    for index, step in enumerate(slider.steps):
        space = spaces[step.rows[0]["recording"]] if step.done else None
        if space is None or (shown is not None and _is_same(space, shown)):
            continue
        shown, at = space, [rr.TimeColumn(slider.name, sequence=[index])]
        low, high = figures.limits(space)
        scale = float(np.min((frame[1] - frame[0]) / (high - low)))
        middle = -scale * (low + high) / 2
        put(stream, "world", rr.Transform3D(translation=[*middle, 0.0], scale=scale), at)
        log_floor(stream, space, at)
        length = _round_length((high[0] - low[0]) / 4)
        start = np.array([low[0], high[1] + 0.15 / scale])
        bar = lift(start + np.array([[0, 0], [length, 0]]), 0.0)
        put(stream, "world/metre", rr.LineStrips3D([bar], radii=0.012 / scale, colors=[200, 206, 216]), at)
        label = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
        beside = bar[1:] + np.array([0.4, 0.18, 0]) / scale  # a label stands below its point
        name = rr.Points3D(beside, radii=0.0, colors=[200, 206, 216], labels=[label], show_labels=True)
        put(stream, "world/metre/length", name, at)


def _round_length(most: float) -> float:
    """The longest of 1, 2, 5, 10 and so on, metres or parts of one, that is at most so long."""
    decade = 10.0 ** np.floor(np.log10(most))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= most))


def _log_heading(
    stream: rr.RecordingStream,
    method: str,
    slider: Slider,
    step: Step,
    frame: tuple[np.ndarray, np.ndarray],
    at: Sequence[rr.TimeColumn],
) -> None:
    """Above a method's field: where the slider stands, and how large the errors are."""
    text = study_text.describe_field(method, slider, step)
    place = [[(frame[0][0] + frame[1][0]) / 2, frame[1][1] + 1.15, 0.0]]
    put(
        stream,
        f"heading/{method}",
        rr.Points3D(place, radii=0.0, colors=_colour(method), labels=[text], show_labels=True),
        at,
    )


def _log_curves(stream: rr.RecordingStream, slider: Slider) -> None:
    """Errors along a slider: of the mean of all seeds, and of the best and the worst where there are several."""
    rows = [(index, row) for index, step in enumerate(slider.steps) for row in step.repeats]
    for method in dict.fromkeys(row["method"] for _, row in rows):
        groups = {
            index: [row for at, row in rows if at == index and row["method"] == method]
            for index in dict.fromkeys(at for at, row in rows if row["method"] == method)
        }
        title, colour, pale = method_title(method), _colour(method), (*_colour(method), 110)
        curves: dict[str, tuple[Take, str, Sequence[int]]] = {"": (mean, title, colour)}
        if max(map(len, groups.values())) > 1:
            curves |= {"/best": (_least, f"{title}, best seed", pale), "/worst": (_most, f"{title}, worst seed", pale)}
        index = [rr.TimeColumn(slider.name, sequence=list(groups))]
        for name in CURVES:
            for end, (take, label, tint) in curves.items():
                path, values = (
                    f"curve/{name}/{method}{end}",
                    [100 * take(group, f"{name}_m") for group in groups.values()],
                )
                put(stream, path, rr.SeriesLines(colors=[tint], names=label, widths=1.0 if end else 2.0))
                stream.send_columns(path, index, rr.Scalars.columns(scalars=values))


def _log_text(stream: rr.RecordingStream, name: str, text: str, at: Sequence[rr.TimeColumn] = ()) -> None:
    put(stream, f"report/{name}", rr.TextDocument(text, media_type="text/markdown"), at)


def _own_values(study: Study, names: Sequence[str]) -> dict[str, object]:
    """What the scenario says of the settings that vary; nothing where its file is gone or is of another version."""
    with suppress(InputError, AttributeError):
        scenario = load_scenario(study.scenario, study.set)
        return {name: read_setting(scenario, name) for name in names}
    return {}


def _open_space(folder: Path, row: Row) -> FreeSpace:
    return open_truth(folder / "runs" / row["run"] / "recording").free_space


def _find_frame(spaces: Spaces) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2,) [m] of a rectangle around the origin in the proportions of the widest and the deepest room."""
    size = np.max([high - low for low, high in map(figures.limits, spaces.values())], axis=0)
    size *= FRAME_M / max(size[1], 0.62 * size[0])
    return -size / 2, size / 2


def _thin(folder: Path, sliders: Sequence[Slider]) -> int:
    """Every how many test positions are shown, so that the file stays small."""
    steps = [step for slider in sliders for step in slider.steps if step.done]
    arrows = sum(len(field.error) for step in steps for field in _read(folder, step).values())
    return max(1, -(-arrows // MOST_ARROWS))


def _read(folder: Path, step: Step) -> dict[str, WorstField]:
    return read_fields(folder / "runs" / step.rows[0]["run"])


def _keep(field: WorstField, every: int) -> WorstField:
    return WorstField(field.truth[::every], field.predicted[::every], field.error[::every])


def _is_same(one: FreeSpace, other: FreeSpace) -> bool:
    same = one.cell_m == other.cell_m and np.array_equal(one.origin, other.origin)
    return same and np.array_equal(one.free, other.free) and np.array_equal(one.reachable, other.reachable)


def _least(rows: Sequence[Row], name: str) -> float:
    return min(row[name] for row in rows)


def _most(rows: Sequence[Row], name: str) -> float:
    return max(row[name] for row in rows)


def _colour(method: str) -> tuple[int, ...]:
    """The method's colour in figures, paler, since the viewer is dark."""
    return tuple(int(255 * (0.7 * part + 0.3)) for part in to_rgb(figures.LINES.get(method, "#888888")))


def _holds(path: Path, identity: str) -> bool:
    """Whether a whole recording of this id stands there."""
    with suppress(InputError):
        return [one.recording_id for one in open_rrd(path).recordings()] == [identity]
    return False


def _hash(folder: Path, rows: Sequence[Row]) -> str:
    state = hashlib.sha256()
    runs = dict.fromkeys(folder / "runs" / row["run"] for row in rows if row["failure"] is None)
    shown = [
        folder / "study.yaml",
        folder / "table.parquet",
        folder / "table.md",
        *sorted(folder.glob("figures/*.png")),
    ]
    for path in [
        *shown,
        *(run / "error_field.npz" for run in runs),
        *(run / "recording/manifest.json" for run in runs),
    ]:
        if not path.is_file():
            raise InputError(f"{folder} is no whole study: {path.relative_to(folder)} is missing")
        state.update(f"{path.relative_to(folder)} {sha256(path)}\n".encode())
    return state.hexdigest()[:32]
