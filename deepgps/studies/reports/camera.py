"""The report of camera faults: one fault at a time, compared with the camera without faults; means over seeds."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D

from deepgps.config.methods import colour_of, title_of
from deepgps.config.scenario import Scenario
from deepgps.reports.style import count_by_decades
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure
from deepgps.studies.reports.seeds import count_folded
from deepgps.studies.table import ERRORS, Row, find_methods, is_seed, mean, read_setting, split_by, write_ratio
from sim.sensors.camera.faults import FAULTS

CLEAN = "no fault"
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
NOTE = (
    "Means over seeds; in brackets, the ratio to the mean without faults. Errors in centimetres on the test grid, for "
    "the worst heading of each position; aligned on training samples, never scaled. Changes between training and "
    "deployment do not appear in the training images. Test positions that moved furniture covers are left out. "
    "DeepGPS with compass sets the images of a camera that leans upright, by turns in training and in use. "
    "Folded: maps that flip more than a tenth of the neighbourhoods, which includes maps that are wrong only in "
    "deployment; said: maps that the detector, which uses only the training images, reports as folded."
)


class Fault(NamedTuple):
    """One fault at one strength, in words, and whether it is present in deployment alone."""

    title: str
    in_use: bool


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each fault and method, and a note on how to read it."""
    faults = group_faults(rows, varied)
    cells = []
    for fault, group in faults.items():
        for method, ours in split_by(group, "method").items():
            clean = [row for row in faults.get(Fault(CLEAN, False), ()) if row["method"] == method]
            errors = [write_ratio(name, ours, clean) for name in ERRORS]
            said = "-" if ours[0]["fold_found"] is None else str(sum(row["fold_found"] for row in ours))
            head = [fault.title, WHEN[fault.in_use], title_of(method), str(len(ours))]
            cells.append([*head, *errors, count_folded(ours), said])
    return [tabulate(["fault", "in", "method", "runs", *ERRORS.values(), "folded", "said"], cells), NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """DeepGPS's error without faults, by what factor the worst fault increases it, and what a leaning camera costs."""
    names = [name for name in TITLES if name in rows[0]]
    faults = group_faults([row for row in rows if row["method"] == "deepgps"], names)
    clean = faults.get(Fault(CLEAN, False), ())
    leans = _measure_lean([row for row in rows if row["method"] == "deepgps_compass"], names)
    if not clean:
        return leans
    figures = {"clean_rms_m": Figure("RMS without faults", mean(clean, "rms_m"), "cm")}
    for in_use, key in ((False, "both"), (True, "deployment")):
        for name, title in (("rms_m", "RMS"), ("median_m", "median")):
            ratios = [
                mean(group, name) / mean(clean, name)
                for fault, group in faults.items()
                if fault.in_use == in_use and fault.title != CLEAN
            ]
            if ratios:
                words = f"{title} / without faults, worst fault in {WHEN[in_use]}"
                figures[f"{key}_{name.removesuffix('_m')}_ratio"] = Figure(words, max(ratios), "")
    return figures | leans


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw errors for each fault: RMS filled, median open, runs small and faint; errors without faults are lines."""
    faults = group_faults(rows, varied)
    methods = find_methods(rows)
    picture = Picture(figsize=(7.4, 1.5 + 0.3 * len(faults)), layout="constrained")
    axes = picture.add_subplot()
    for place, group in enumerate(faults.values()):
        for number, method in enumerate(methods):
            ours = [row for row in group if row["method"] == method]
            at = place + 0.5 * ((number + 0.5) / len(methods) - 0.5)
            colour = colour_of(method)
            for name, inside in (("rms_m", colour), ("median_m", "white")) if ours else ():
                values = [100 * row[name] for row in ours]
                axes.plot(values, [at] * len(ours), ".", color=colour, alpha=0.35, ms=4, mew=0)
                axes.plot(100 * mean(ours, name), at, "o", color=colour, mfc=inside, ms=5, zorder=3)
    for row_method, clean in split_by(faults.get(Fault(CLEAN, False), ()), "method").items():
        for name, style in (("rms_m", "-"), ("median_m", (0, (3, 3)))):
            colour = colour_of(row_method)
            axes.axvline(100 * mean(clean, name), color=colour, linestyle=style, lw=1.0, alpha=0.55, zorder=1)
    changed = [place for place, fault in enumerate(faults) if fault.in_use]
    if changed:
        axes.axhspan(changed[0] - 0.5, changed[-1] + 0.5, color="#f1ede4", zorder=0, lw=0)
        axes.text(
            0.995,
            changed[0] - 0.42,
            "deployment only",
            transform=axes.get_yaxis_transform(),
            ha="right",
            va="top",
            size=8,
        )
    axes.set_yticks(range(len(faults)), [fault.title for fault in faults])
    axes.set(xscale="log", ylim=(len(faults) - 0.5, -0.5))
    axes.set_xlabel(
        "error of the worst heading [cm]\nfilled: RMS, open: median, means over seeds\nlines: without faults"
    )
    count_by_decades(axes.xaxis)
    axes.grid(alpha=0.2, which="major", axis="x")
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    marks = [Line2D([], [], color=colour_of(name), marker="o", ls="") for name in methods]
    picture.legend(marks, map(title_of, methods), loc="outside upper right", ncols=len(methods), frameon=False)
    return picture


def group_faults(rows: Sequence[Row], varied: Sequence[str]) -> Mapping[Fault, Sequence[Row]]:
    """Group rows by the settings that differ from their defaults; faults in deployment alone come last."""
    usual = {name: read_setting(Scenario(), name) for name in varied if not is_seed(name)}
    groups: dict[Fault, list[Row]] = {}
    for row in rows:
        faults = [name for name in usual if row[name] != usual[name]]
        title = ", ".join(TITLES.get(name, f"{name} {{}}").format(row[name]) for name in faults) or CLEAN
        in_use = bool(faults) and all(name.startswith("deployment.") for name in faults)
        groups.setdefault(Fault(title, in_use), []).append(row)
    return dict(sorted(groups.items(), key=lambda item: item[0].in_use))


def _measure_lean(rows: Sequence[Row], varied: Sequence[str]) -> dict[str, Figure]:
    """By what factor a camera that leans increases the median of the compass, which sets its images upright."""
    figures, faults = {}, group_faults(rows, varied)
    clean = faults.get(Fault(CLEAN, False), ())
    for setting, name in LEANS.items() if clean else ():
        for lean in sorted({row[setting] for row in rows if row.get(setting)}):
            title = TITLES[setting].format(lean)
            group = faults.get(Fault(title, setting.startswith("deployment.")))
            if group is None:  # only together with other faults
                continue
            words = f"{title_of('deepgps_compass')}: median / without faults, {title}"
            ratio = mean(group, "median_m") / mean(clean, "median_m")
            figures[f"compass_{name}_{lean:g}_ratio"] = Figure(words, ratio, "")
    return figures
