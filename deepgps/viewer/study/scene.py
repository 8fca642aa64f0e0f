"""What a study shows along a slider: the floor plan, a heading above each error field, and curves."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import rerun as rr

from deepgps.figures import field_plot
from deepgps.figures.style import colour_on_dark
from deepgps.methods.catalog import title_of
from deepgps.studies.table import Row, find_methods, mean
from deepgps.viewer.scene import Places, lift, log_floor, put
from deepgps.viewer.study.layout import CURVES, Frame
from deepgps.viewer.study.sliders import Slider, Step
from deepgps.viewer.study.text import describe_field
from sim.occupancy import FreeSpace

FRAME_M = 4.5  # depth of the rectangle that rooms are drawn in, chosen to suit the size of the text
Spaces = Mapping[str, FreeSpace]  # by the name of the recording
Take = Callable[[Sequence[Row], str], float]


def find_frame(spaces: Spaces) -> Frame:
    """Corners (2,) [m] of a rectangle around the origin in the proportions of the widest and the deepest room."""
    size = np.max([high - low for low, high in map(field_plot.limits, spaces.values())], axis=0)
    size *= FRAME_M / max(size[1], 0.62 * size[0])
    return -size / 2, size / 2


def log_rooms(stream: rr.RecordingStream, slider: Slider, spaces: Spaces, frame: Frame) -> None:
    """Log the floor plan where it changes along a slider, scaled into the frame, and a scale bar of known length."""
    shown = None
    for index, step in enumerate(slider.steps):
        space = spaces[step.rows[0]["recording"]] if step.done else None
        if space is None or (shown is not None and _is_same(space, shown)):
            continue
        shown, at = space, [rr.TimeColumn(slider.name, sequence=[index])]
        low, high = field_plot.limits(space)
        scale = float(np.min((frame[1] - frame[0]) / (high - low)))
        middle = -scale * (low + high) / 2
        put(stream, "world", rr.Transform3D(translation=[*middle, 0.0], scale=scale), at)
        log_floor(stream, space, at)
        length = _round_length((high[0] - low[0]) / 4)
        start = np.array([low[0], high[1] + 0.15 / scale])
        bar = lift(start + np.array([[0, 0], [length, 0]]), 0.0)
        put(stream, "world/metre", rr.LineStrips3D([bar], radii=0.012 / scale, colors=[200, 206, 216]), at)
        label = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
        beside = bar[1:] + np.array([0.4, 0.18, 0]) / scale  # a label is drawn below its point
        name = rr.Points3D(beside, radii=0.0, colors=[200, 206, 216], labels=[label], show_labels=True)
        put(stream, "world/metre/length", name, at)


def log_heading(
    stream: rr.RecordingStream,
    method: str,
    slider: Slider,
    step: Step,
    frame: Frame,
    at: Places,
) -> None:
    """Log the slider's place and the size of the errors above a method's error field."""
    text = describe_field(method, slider, step)
    place = [[(frame[0][0] + frame[1][0]) / 2, frame[1][1] + 1.15, 0.0]]
    put(
        stream,
        f"heading/{method}",
        rr.Points3D(place, radii=0.0, colors=colour_on_dark(method), labels=[text], show_labels=True),
        at,
    )


def log_curves(stream: rr.RecordingStream, slider: Slider) -> None:
    """Log errors along a slider: the mean over seeds, and the best and the worst seed if there are several."""
    rows = [(index, row) for index, step in enumerate(slider.steps) for row in step.repeats]
    for method in find_methods(row for _, row in rows):
        groups = {
            index: [row for at, row in rows if at == index and row["method"] == method]
            for index in dict.fromkeys(at for at, row in rows if row["method"] == method)
        }
        title, colour, pale = title_of(method), colour_on_dark(method), (*colour_on_dark(method), 110)
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


def _round_length(most: float) -> float:
    """The longest length of at most ``most`` [m] that is 1, 2 or 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(most))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= most))


def _is_same(one: FreeSpace, other: FreeSpace) -> bool:
    same = one.cell_m == other.cell_m and np.array_equal(one.origin, other.origin)
    return same and np.array_equal(one.free, other.free) and np.array_equal(one.reachable, other.reachable)


def _least(rows: Sequence[Row], name: str) -> float:
    return min(row[name] for row in rows)


def _most(rows: Sequence[Row], name: str) -> float:
    return max(row[name] for row in rows)
