"""Pictures that several reports draw: errors as dots, with a line for each room, group or fault."""

from collections.abc import Iterable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.style import count_by_decades
from deepgps.studies.table import Row, find_methods

Size = tuple[float, float]


def draw_dots(lines: Mapping[str, Sequence[Row]], size: Size) -> Picture:
    """Draw RMS (filled) and median (open) of every method, with a line for each label."""
    picture = Picture(figsize=size, layout="constrained")
    axes = picture.add_subplot()
    placed = [(place, row) for place, rows in enumerate(lines.values()) for row in rows]
    for method in find_methods(row for _, row in placed):
        colour, title = colour_of(method), title_of(method)
        places = [place for place, row in placed if row["method"] == method]
        for name, inside, word in (("rms_m", colour, "RMS"), ("median_m", "none", "median")):
            values = [100 * row[name] for _, row in placed if row["method"] == method]
            axes.plot(values, places, "o", color=colour, mfc=inside, label=f"{title}, {word}")
    axes.set_yticks(range(len(lines)), list(lines))
    axes.set(xscale="log", xlabel="error of the worst heading [cm]", ylim=(len(lines) - 0.5, -0.5))
    count_by_decades(axes.xaxis)
    axes.grid(alpha=0.25, which="both")
    return picture


def spread_methods(place: int, methods: Sequence[str], width: float) -> dict[str, float]:
    """Where the dots of each method are, side by side around a line's place."""
    return {method: place + width * ((number + 0.5) / len(methods) - 0.5) for number, method in enumerate(methods)}


def finish_lines(axes: Axes, count: int) -> None:
    """Scale the axes of dots on so many lines, without a frame."""
    axes.set(xscale="log", ylim=(count - 0.5, -0.5))
    count_by_decades(axes.xaxis)
    axes.grid(alpha=0.2, which="major", axis="x")
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)


def add_methods(picture: Picture, methods: Iterable[str], also: Mapping[str, Line2D], **style: float) -> None:
    """Add a legend of the methods' colours, and of other marks by their words."""
    marks = {title_of(name): _mark(colour_of(name)) for name in methods} | dict(also)
    picture.legend(
        list(marks.values()), list(marks), loc="outside upper right", ncols=len(marks), frameon=False, **style
    )


def _mark(colour: str) -> Line2D:
    return Line2D([], [], color=colour, marker="o", ls="")
