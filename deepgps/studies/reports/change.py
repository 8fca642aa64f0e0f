"""The report of changes between training and use: light, exposure, a person, furniture; means over seeds."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.style import count_by_decades
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure
from deepgps.studies.reports.camera import CLEAN, TITLES, group_faults
from deepgps.studies.table import ERRORS, Row, find_methods, mean, split_by, write_ratio

LIGHT, VALUES = "drive.mixed_light", "learn.features.values"
LIGHTS = {False: "one light", True: "several lights"}
NO_CHANGE = "no change"
FIGURES = {
    "light_0.5_ratio": ("all light x 0.5",),
    "light_0.2_ratio": ("all light x 0.2",),
    "lamps_0_ratio": ("lamps x 0",),
    "mixed_ratio": ("daylight x 1, lamps x 0", "daylight x 0.3", "daylight x 0", "a lamp switched on"),
    "person_ratio": ("a person in view",),
}
"""Figures with a target, and the changes of which the worst is taken."""
ACCEPTED = {"accepted": ("accepted [%]", 100.0), "rms_accepted_m": ("its RMS [cm]", 100.0)}
"""Columns that a table may lack: share of the images that are not refused, and the error of these."""
NOTE = (
    "Means over seeds; in brackets, the ratio to the mean without a change, with the same training. Errors on the test "
    "grid, for the worst heading of each position; aligned on training samples, never scaled. The training images show "
    "none of the changes but that of the light, and that only with several lights: daylight 0.3, lamps off, night. "
    "Test positions that moved furniture covers are left out."
)
Groups = Mapping[str, Sequence[Row]]


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table for each light of training and kind of features, with a line for each change and method."""
    blocks = []
    for title, some in split_trainings(rows).items():
        changes, has = group_changes(some, varied), [name for name in ACCEPTED if _is_known(some, name)]
        cells = []
        for change, group in changes.items():
            for method, ours in split_by(group, "method").items():
                errors = [write_ratio(name, ours, _pick(changes, method)) for name in ERRORS]
                more = [_write_accepted(ours, name) for name in has]
                cells.append([change, title_of(method), str(len(ours)), *errors, *more])
        headings = ["change", "method", "runs", *ERRORS.values(), *(ACCEPTED[name][0] for name in has)]
        blocks += [f"## {title[0].upper()}{title[1:]}", tabulate(headings, cells)]
    return [*blocks, NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """By what factor changes raise the median of DeepGPS with compass, trained in one light.

    Where features of pixels and of ranks are compared, those of ranks count.
    """
    ours = [row for row in rows if row["method"] == "deepgps_compass" and row.get(VALUES, "ranks") == "ranks"]
    changes = group_changes([row for row in ours if not row.get(LIGHT)], [name for name in TITLES if name in rows[0]])
    usual = changes.get(NO_CHANGE, ())
    figures = {}
    for name, wanted in FIGURES.items() if usual else ():
        found = {title: mean(group, "median_m") / mean(usual, "median_m") for title, group in changes.items()}
        ratios = {title: found[title] for title in wanted if title in found}
        if ratios:
            worst = max(ratios, key=lambda title: ratios[title])
            figures[name] = Figure(f"median / without a change, {worst}", ratios[worst], "")
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw median errors for each change, a panel for each light of training; open: features of pixels."""
    lights, methods = split_by(rows, LIGHT), find_methods(rows)
    titles = list(group_changes(rows, varied))
    picture = Picture(figsize=(7.4, 1.6 + 0.3 * len(titles)), layout="constrained")
    panels = picture.subplots(1, len(lights), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (light, some) in zip(panels, lights.items(), strict=True):
        for change, group in group_changes(some, varied).items():
            for number, method in enumerate(methods):
                at = titles.index(change) + 0.6 * ((number + 0.5) / len(methods) - 0.5)
                ours = split_values([row for row in group if row["method"] == method])
                for values, same in ours.items():
                    colour = colour_of(method)
                    inside = "white" if values == "pixels" else colour
                    axes.plot(100 * mean(same, "median_m"), at, "o", color=colour, mfc=inside, ms=5)
        axes.set_title(f"trained in {LIGHTS[light]}", fontsize=9)
        axes.set(xscale="log", ylim=(len(titles) - 0.5, -0.5), xlabel="median error [cm]")
        count_by_decades(axes.xaxis)
        axes.grid(alpha=0.2, which="major", axis="x")
        axes.tick_params(axis="y", length=0)
        axes.spines[["top", "right", "left"]].set_visible(False)
    panels[0].set_yticks(range(len(titles)), titles, fontsize=8)
    marks = [Line2D([], [], color=colour_of(name), marker="o", ls="") for name in methods]
    words = list(map(title_of, methods))
    if VALUES in rows[0]:
        words.append("filled: ranks, open: pixels")
        marks.append(Line2D([], [], color="grey", marker="o", ls=""))
    picture.legend(marks, words, loc="outside upper right", ncols=len(marks), frameon=False, fontsize=8)
    return picture


def split_trainings(rows: Sequence[Row]) -> Groups:
    """Rows by what the methods learned from: the light of the training drive, and what features are made of."""
    return {
        f"trained in {LIGHTS[light]}" + (f", features of {values}" if values else ""): same
        for light, some in split_by(rows, LIGHT).items()
        for values, same in split_values(some).items()
    }


def split_values(rows: Sequence[Row]) -> dict[str | None, list[Row]]:
    """Rows by what features are made of; all under None where a study does not vary it."""
    return split_by([{VALUES: None, **row} for row in rows], VALUES)


def group_changes(rows: Sequence[Row], varied: Sequence[str]) -> Groups:
    """Rows by what changed in deployment, in words."""
    names = [name for name in varied if name.startswith("deployment.")]
    found = {fault.title: group for fault, group in group_faults(rows, names).items()}
    return {NO_CHANGE if title == CLEAN else title: group for title, group in found.items()}


def _pick(changes: Groups, method: str) -> list[Row]:
    return [row for row in changes.get(NO_CHANGE, ()) if row["method"] == method]


def _is_known(rows: Sequence[Row], name: str) -> bool:
    return any(row.get(name) is not None for row in rows)


def _write_accepted(rows: Sequence[Row], name: str) -> str:
    return f"{ACCEPTED[name][1] * mean(rows, name):.1f}" if all(row.get(name) is not None for row in rows) else "-"
