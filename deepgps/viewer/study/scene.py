"""What a study shows along a slider: the floor plan, a heading above each error field, and curves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import rerun as rr

from deepgps.config.methods import title_of
from deepgps.reports import field_plot
from deepgps.reports.style import colour_on_dark
from deepgps.studies.table import Row, find_methods
from deepgps.viewer.plot import Axis, Curve, log_cursor, log_plot, make_axis
from deepgps.viewer.scene import Places, lift, log_floor, put
from deepgps.viewer.study.layout import CURVES, Frame
from deepgps.viewer.study.sliders import Slider, Step
from deepgps.viewer.study.text import describe_field
from sim.occupancy import FreeSpace

FRAME_M = 4.5  # depth of the rectangle that rooms are drawn in, chosen to suit the size of the text
MOST_TICKS, MOST_LETTERS = 8, 12
WIDE = 3.0  # natural logarithm of the ratio from which on errors are drawn on a logarithmic axis
Spaces = Mapping[str, FreeSpace]  # by the name of the recording


def find_frame(spaces: Spaces) -> Frame:
    """Corners (2,) [m] of a rectangle around the origin in the proportions of the widest and the deepest room."""
    size = np.max([high - low for low, high in map(field_plot.limits, spaces.values())], axis=0)
    size *= FRAME_M / max(size[1], 0.62 * size[0])
    return -size / 2, size / 2


def log_rooms(stream: rr.RecordingStream, slider: Slider, spaces: Spaces, frame: Frame) -> None:
    """Log the floor plan where it changes along a slider, scaled into the frame, and a scale bar of known length."""
    shown = None
    for place, step in zip(slider.places, slider.steps, strict=True):
        space = spaces[step.rows[0]["recording"]] if step.done else None
        if space is None or (shown is not None and _is_same(space, shown)):
            continue
        shown, at = space, [rr.TimeColumn(slider.timeline, sequence=[place])]
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
    """Plot errors against a slider's values: the mean over seeds, and the best and the worst seed if there are several.

    A cursor in the plots is where the slider is.
    """
    where = slider.numbers or [float(place) for place in slider.places]
    rows = [(place, row) for place, step in zip(where, slider.steps, strict=True) for row in step.repeats]
    if not rows:
        return
    x, first = _make_abscissa(slider, where), min(slider.places)
    for name, title in CURVES.items():
        curves = [
            curve for method in find_methods(row for _, row in rows) for curve in _make_curves(method, name, rows)
        ]
        errors = np.concatenate([curve.y for curve in curves])
        y = make_axis(f"{title} [cm]", errors, log=bool(errors.min() > 0 and np.ptp(np.log(errors)) > WIDE), zero=True)
        log_plot(stream, f"curve/{name}", x, y, curves, [rr.TimeColumn(slider.timeline, sequence=[first])])
        for place, value in zip(slider.places, where, strict=True):
            at = [rr.TimeColumn(slider.timeline, sequence=[place])]
            log_cursor(stream, f"curve/{name}", x, value, at)


def _make_abscissa(slider: Slider, where: Sequence[float]) -> Axis:
    """The axis of a slider's values: in proportion where they are numbers, else one step after another."""
    if slider.numbers:
        axis = make_axis(slider.name, where, log=min(where) > 0 and max(where) > 30 * min(where))
        axis = replace(axis, low=min(axis.low, *where), high=max(where))
        return replace(axis, ticks=_choose_ticks(axis, slider))
    every = -(-len(where) // MOST_TICKS)
    ticks = {place: _cut(step.value) for place, step in list(zip(where, slider.steps, strict=True))[::every]}
    return Axis(slider.name, min(where) - 0.5, max(where) + 0.5, ticks)


def _choose_ticks(axis: Axis, slider: Slider) -> dict[float, str]:
    """The slider's own values, without those too close to the one before."""
    ticks: dict[float, str] = {}
    for value, step in sorted(zip(slider.numbers, slider.steps, strict=True), key=lambda pair: pair[0]):
        if not ticks or axis.share([value])[0] - axis.share([list(ticks)[-1]])[0] > 1 / MOST_TICKS:
            ticks[value] = step.value
    return ticks


def _make_curves(method: str, name: str, rows: Sequence[tuple[float, Row]]) -> list[Curve]:
    """A method's curves over places: the mean of its rows there, and pale without a title the least and the most."""
    groups = {
        place: [100 * row[f"{name}_m"] for at, row in rows if at == place and row["method"] == method]
        for place in dict.fromkeys(at for at, row in rows if row["method"] == method)
    }
    colour, places = colour_on_dark(method), list(groups)
    curves = [Curve(method, title_of(method), colour, places, [float(np.mean(one)) for one in groups.values()], True)]
    if max(map(len, groups.values())) > 1:
        for end, take in (("best", min), ("worst", max)):
            curves.append(Curve(f"{method}_{end}", "", (*colour, 110), places, [take(one) for one in groups.values()]))
    return curves


def _cut(text: str) -> str:
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 1]}…"


def _round_length(most: float) -> float:
    """The longest length of at most ``most`` [m] that is 1, 2 or 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(most))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= most))


def _is_same(one: FreeSpace, other: FreeSpace) -> bool:
    same = one.cell_m == other.cell_m and np.array_equal(one.origin, other.origin)
    return same and np.array_equal(one.free, other.free) and np.array_equal(one.reachable, other.reachable)
