"""The reports "camera" and "change": one fault or change at a time, compared with none; means over seeds."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D

from deepgps.config.methods import colour_of, title_of
from deepgps.config.scenario import Scenario
from deepgps.reports.plots import count_by_decades
from deepgps.reports.targets import Figure, compare_means
from deepgps.studies.reports.columns import FOLDED, RATIOS, RUNS, Column, Line, form, tabulate_lines
from deepgps.studies.table import Row, find_methods, is_seed, mean, read_setting, split_by, split_by_label
from sim.sensors.camera.faults import FAULTS

CLEAN, NO_CHANGE = "no fault", "no change"
# formats of a fault's strength, by the setting's name
TITLES = {
    **{f"image_faults.{name}": title for fault in FAULTS for name, title in fault.titles.items()},
    "camera_mount.driven_m": "driven {:g} m during exposure",
    "camera_mount.roll_deg": "tilted {:g}° to the right",
    "camera_mount.pitch_deg": "tilted {:g}° forward",
    "camera_mount.wobble_deg": "wobbling by {:g}°",
    "camera_mount.ahead_m": "{:g} m ahead of the axle",
    "camera_mount.left_m": "{:g} m to the left of the axle",
    "camera_mount.centre_px": "optical centre off by {:g} of 480 px",
    "deployment.light": "all light x {:g}",
    "deployment.lamps": "lamps x {:g}",
    "deployment.daylight": "daylight x {:g}",
    "deployment.lamp_on": "a lamp switched on",
    "deployment.exposure": "automatic exposure",
    "deployment.person": "a person in view",
    "deployment.moved_m": "furniture moved {:g} m",
    "deployment.camera_mount.roll_deg": "knocked {:g}° to the right",
    "deployment.camera_mount.centre_px": "knocked, optical centre off by {:g} of 480 px",
}
LEANS = {"camera_mount.roll_deg": "tilted", "deployment.camera_mount.roll_deg": "knocked"}
WHEN = {True: "deployment only", False: "training and deployment"}
CAMERA_NOTE = (
    "Means over seeds; in brackets, the ratio to the mean without faults. Errors in centimetres on the test grid, for "
    "the worst heading of each position; aligned on training samples, never scaled. Changes between training and "
    "deployment do not appear in the training images. Test positions that moved furniture covers are left out. "
    "DeepGPS with compass sets the images of a camera that leans upright, by turns in training and in use. "
    "Folded: maps that flip more than a tenth of the neighbourhoods, which includes maps that are wrong only in "
    "deployment; said: maps that the detector, which uses only the training images, reports as folded."
)
LIGHT, VALUES = "drive.mixed_light", "learn.features.values"
LIGHTS = {False: "one light", True: "several lights"}
WORST_OF = {
    "light_0.5_ratio": ("all light x 0.5",),
    "light_0.2_ratio": ("all light x 0.2",),
    "lamps_0_ratio": ("lamps x 0",),
    "mixed_ratio": ("daylight x 1, lamps x 0", "daylight x 0.3", "daylight x 0", "a lamp switched on"),
    "person_ratio": ("a person in view",),
}
"""Figures with a target, and the changes of which the worst is taken."""
CHANGE_NOTE = (
    "Means over seeds; in brackets, the ratio to the mean without a change, with the same training. Errors on the test "
    "grid, for the worst heading of each position; aligned on training samples, never scaled. The training images show "
    "none of the changes but that of the light, and that only with several lights: daylight 0.3, lamps off, night. "
    "Test positions that moved furniture covers are left out."
)


class Fault(NamedTuple):
    """One fault at one strength, in words, and whether it is present in deployment alone."""

    title: str
    in_use: bool


NO_FAULT = Fault(CLEAN, False)


def _column_if_known(heading: str, name: str) -> Column:
    return Column(heading, form(name, ".1f", 100), lambda rows: any(row.get(name) is not None for row in rows))


OF_CHANGE = (
    *(RUNS, *RATIOS),
    _column_if_known("accepted [%]", "accepted"),
    _column_if_known("its RMS [cm]", "rms_accepted_m"),
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each fault and method, and a note on how to read it."""
    faults = group_faults(rows, varied)
    named = {(fault.title, WHEN[fault.in_use]): group for fault, group in faults.items()}
    lines = _compare(named, faults.get(NO_FAULT, ()))
    return [tabulate_lines(["fault", "in", "method"], lines, (RUNS, *RATIOS, *FOLDED)), CAMERA_NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """DeepGPS's error without faults, by what factor the worst fault increases it, and what a leaning camera costs."""
    names = [name for name in TITLES if name in rows[0]]
    faults = group_faults([row for row in rows if row["method"] == "deepgps"], names)
    clean = faults.get(NO_FAULT, ())
    leans = _measure_lean([row for row in rows if row["method"] == "deepgps_compass"], names)
    if not clean:
        return leans
    figures = {"clean_rms_m": Figure("RMS without faults", mean(clean, "rms_m"), "cm")}
    for in_use, key in ((False, "both"), (True, "deployment")):
        groups = [group for fault, group in faults.items() if fault.in_use == in_use and fault.title != CLEAN]
        for name, title in (("rms_m", "RMS"), ("median_m", "median")) if groups else ():
            words = f"{title} / without faults, worst fault in {WHEN[in_use]}"
            worst = max(mean(group, name) / mean(clean, name) for group in groups)
            figures[f"{key}_{name.removesuffix('_m')}_ratio"] = Figure(words, worst, "")
    return figures | leans


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw errors for each fault: RMS filled, median open, runs small and faint; errors without faults are lines."""
    faults, methods = group_faults(rows, varied), find_methods(rows)
    picture = Picture(figsize=(7.4, 1.5 + 0.3 * len(faults)), layout="constrained")
    axes = picture.add_subplot()
    for place, group in enumerate(faults.values()):
        places = _spread_methods(place, methods, 0.5)
        for method, ours in split_by(group, "method").items():
            at, colour = places[method], colour_of(method)
            for name, inside in (("rms_m", colour), ("median_m", "white")):
                values = [100 * row[name] for row in ours]
                axes.plot(values, [at] * len(ours), ".", color=colour, alpha=0.35, ms=4, mew=0)
                axes.plot(100 * mean(ours, name), at, "o", color=colour, mfc=inside, ms=5, zorder=3)
    for method, clean in split_by(faults.get(NO_FAULT, ()), "method").items():
        for name, style in (("rms_m", "-"), ("median_m", (0, (3, 3)))):
            colour = colour_of(method)
            axes.axvline(100 * mean(clean, name), color=colour, linestyle=style, lw=1.0, alpha=0.55, zorder=1)
    if changed := [place for place, fault in enumerate(faults) if fault.in_use]:
        axes.axhspan(changed[0] - 0.5, changed[-1] + 0.5, color="#f1ede4", zorder=0, lw=0)
        where = {"transform": axes.get_yaxis_transform(), "ha": "right", "va": "top"}
        axes.text(0.995, changed[0] - 0.42, "deployment only", size=8, **where)
    axes.set_yticks(range(len(faults)), [fault.title for fault in faults])
    axes.set_xlabel(
        "error of the worst heading [cm]\nfilled: RMS, open: median, means over seeds\nlines: without faults"
    )
    _finish_lines(axes, len(faults))
    _add_methods(picture, methods, {})
    return picture


def group_faults(rows: Iterable[Row], varied: Sequence[str]) -> Mapping[Fault, Sequence[Row]]:
    """Group rows by the settings that differ from their defaults; faults in deployment alone come last."""
    usual = {name: read_setting(Scenario(), name) for name in varied if not is_seed(name)}

    def name_fault(row: Row) -> Fault:
        faults = [name for name in usual if row[name] != usual[name]]
        title = ", ".join(TITLES.get(name, f"{name} {{}}").format(row[name]) for name in faults) or CLEAN
        return Fault(title, bool(faults) and all(name.startswith("deployment.") for name in faults))

    return dict(sorted(split_by_label(rows, name_fault).items(), key=lambda item: item[0].in_use))


def report_changes(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table for each light of training and kind of features, with a line for each change and method."""
    blocks = []
    for title, some in split_trainings(rows).items():
        changes = group_changes(some, varied)
        lines = _compare({(change,): group for change, group in changes.items()}, changes.get(NO_CHANGE, ()))
        blocks += [f"## {title[0].upper()}{title[1:]}", tabulate_lines(["change", "method"], lines, OF_CHANGE)]
    return [*blocks, CHANGE_NOTE]


def measure_changes(rows: Sequence[Row]) -> dict[str, Figure]:
    """By what factor changes raise the median of DeepGPS with compass, trained in one light.

    Where features of pixels and of ranks are compared, those of ranks count.
    """
    ours = [row for row in rows if row["method"] == "deepgps_compass" and row.get(VALUES, "ranks") == "ranks"]
    changes = group_changes([row for row in ours if not row.get(LIGHT)], [name for name in TITLES if name in rows[0]])
    usual = changes.get(NO_CHANGE, ())
    figures = {}
    for name, titles in WORST_OF.items() if usual else ():
        medians = {title: mean(changes[title], "median_m") for title in titles if title in changes}
        if medians:
            worst = max(medians, key=lambda title: medians[title])
            title = f"median / without a change, {worst}"
            figures[name] = compare_means(title, changes[worst], usual, "median_m")
    return figures


def draw_changes(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw median errors for each change, a panel for each light of training; open: features of pixels."""
    lights, methods = split_by(rows, LIGHT), find_methods(rows)
    titles = list(group_changes(rows, varied))
    picture = Picture(figsize=(7.4, 1.6 + 0.3 * len(titles)), layout="constrained")
    panels = picture.subplots(1, len(lights), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (light, some) in zip(panels, lights.items(), strict=True):
        for change, group in group_changes(some, varied).items():
            places = _spread_methods(titles.index(change), methods, 0.6)
            for method, ours in split_by(group, "method").items():
                for values, same in split_values(ours).items():
                    colour = colour_of(method)
                    inside = "white" if values == "pixels" else colour
                    axes.plot(100 * mean(same, "median_m"), places[method], "o", color=colour, mfc=inside, ms=5)
        axes.set_title(f"trained in {LIGHTS[light]}", fontsize=9)
        axes.set_xlabel("median error [cm]")
        _finish_lines(axes, len(titles))
    panels[0].set_yticks(range(len(titles)), titles, fontsize=8)
    mark = {"filled: ranks, open: pixels": Line2D([], [], color="grey", marker="o", ls="")}
    _add_methods(picture, methods, mark if VALUES in rows[0] else {}, fontsize=8)
    return picture


def split_trainings(rows: Sequence[Row]) -> Mapping[str, Sequence[Row]]:
    """Rows by what the methods learned from: the light of the training drive, and what features are made of."""
    return {
        f"trained in {LIGHTS[light]}" + (f", features of {values}" if values else ""): same
        for light, some in split_by(rows, LIGHT).items()
        for values, same in split_values(some).items()
    }


def split_values(rows: Sequence[Row]) -> dict[str | None, list[Row]]:
    """Rows by what features are made of; all under None where a study does not vary it."""
    return split_by_label(rows, lambda row: row.get(VALUES))


def group_changes(rows: Iterable[Row], varied: Sequence[str]) -> Mapping[str, Sequence[Row]]:
    """Rows by what changed in deployment, in words."""
    faults = group_faults(rows, [name for name in varied if name.startswith("deployment.")])
    return {NO_CHANGE if fault.title == CLEAN else fault.title: group for fault, group in faults.items()}


def _spread_methods(place: int, methods: Sequence[str], width: float) -> dict[str, float]:
    """Where the dots of each method are, side by side around a line's place."""
    return {method: place + width * ((number + 0.5) / len(methods) - 0.5) for number, method in enumerate(methods)}


def _finish_lines(axes: Axes, count: int) -> None:
    """Scale the axes of dots on so many lines, without a frame."""
    axes.set(xscale="log", ylim=(count - 0.5, -0.5))
    count_by_decades(axes.xaxis)
    axes.grid(alpha=0.2, which="major", axis="x")
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)


def _add_methods(picture: Picture, methods: Iterable[str], also: Mapping[str, Line2D], **style: float) -> None:
    """Add a legend of the methods' colours, and of other marks by their words."""
    marks = {title_of(name): _mark(colour_of(name)) for name in methods} | dict(also)
    picture.legend(
        list(marks.values()), list(marks), loc="outside upper right", ncols=len(marks), frameon=False, **style
    )


def _mark(colour: str) -> Line2D:
    return Line2D([], [], color=colour, marker="o", ls="")


def _compare(groups: Mapping[tuple[str, ...], Sequence[Row]], clean: Sequence[Row]) -> Iterator[Line]:
    """A line for each group and method, compared with the same method's clean rows."""
    base = split_by(clean, "method")
    for key, group in groups.items():
        for method, ours in split_by(group, "method").items():
            yield Line((*key, title_of(method)), ours, base.get(method, ()))


def _measure_lean(rows: Sequence[Row], varied: Sequence[str]) -> dict[str, Figure]:
    """By what factor a camera that leans increases the median of the compass, which sets its images upright."""
    figures, faults = {}, group_faults(rows, varied)
    clean = faults.get(NO_FAULT, ())
    for setting, name in LEANS.items() if clean else ():
        for lean in sorted({row[setting] for row in rows if row.get(setting)}):
            title = TITLES[setting].format(lean)
            # there may be none: a lean only together with other faults
            if group := faults.get(Fault(title, setting.startswith("deployment."))):
                words = f"{title_of('deepgps_compass')}: median / without faults, {title}"
                figures[f"compass_{name}_{lean:g}_ratio"] = compare_means(words, group, clean, "median_m")
    return figures
