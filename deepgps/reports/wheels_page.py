"""The wheels in text and plots: what the diagnosis finds, and the encoders' segments against the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure
from rich.console import Console

from deepgps.diagnosis.diagnosis import Diagnosis, Estimate
from deepgps.diagnosis.findings import UNKNOWN_SCALE_NOTE, Finding, find_faults, list_smallest
from deepgps.evaluation.segment_errors import measure_segments
from deepgps.evaluation.wheels import Wheels, list_errors, measure_spread
from deepgps.reports.plots import SCREEN
from deepgps.reports.table import print_table, say, tabulate
from sim.recording.format import Recording
from sim.sensors.encoder import measure_tick
from sim.settings import EncoderSettings, RobotSettings

ENCODER_COLOUR, TRUE_COLOUR = "#ff9628", "#5aa0ff"


NO_FAULT_NOTE = "Nothing is wrong with these wheels, as far as the robot's own sensors can tell."
TOO_SHORT_NOTE = "Too little of the drive could be used to tell what is wrong with these wheels."
HEADINGS = ("quantity", "found", "95 % interval", "assumed", "detectable")


@dataclass(frozen=True)
class Quantity:
    """How an estimate is written: its title, unit, the unit's size, its decimals, and the fault that it shows."""

    title: str
    unit: str
    size: float
    decimals: int
    fault: str


QUANTITIES = {
    "track_m": Quantity("track width, with these radii", "mm", 1e-3, 2, "track"),
    "reading_ratio": Quantity("readings, right over left", "", 1.0, 4, "radius"),
    "wheel_ratio": Quantity("radius, right over left", "", 1.0, 4, "wheel"),
    "step_noise": Quantity("noise of a gap", "%", 1e-2, 2, "step_noise"),
    "slip_per_m": Quantity("slip in a metre", "mm", 1e-3, 2, "slip"),
    "tick_m": Quantity("tick", "mm", 1e-3, 2, "ticks"),
    "dropout": Quantity("readings lost", "%", 1e-2, 2, "dropout"),
    "stuck_fraction": Quantity("gaps with a stuck wheel", "%", 1e-2, 2, "stuck"),
}


DEG = np.pi / 180
REAL_QUANTITIES = {
    "left_m": Quantity("left radius", "mm", 1e-3, 2, "wheel"),
    "right_m": Quantity("right radius", "mm", 1e-3, 2, "wheel"),
    "track_m": Quantity("track width", "mm", 1e-3, 2, "track"),
    "step_noise": QUANTITIES["step_noise"],
    "slip_per_m": QUANTITIES["slip_per_m"],
    "length_per_m": Quantity("length, after a metre", "mm", 1e-3, 2, "slip"),
    "heading_per_m": Quantity("heading, after a metre", "deg", DEG, 2, "slip"),
    "heading_per_rad": Quantity("heading, after a radian", "deg", DEG, 2, "slip"),
    "tracker_m": Quantity("tracker, length of a gap", "mm", 1e-3, 2, ""),
    "tracker_rad": Quantity("tracker, turn of a gap", "deg", DEG, 2, ""),
}
"""Quantities that a tracker tells; errors after a metre and a radian are random."""


def list_rows(diagnosis: Diagnosis) -> list[list[str]]:
    """A row for each quantity: its title, value, interval, what is assumed, and the smallest detectable fault."""
    least, odometry = list_smallest(diagnosis), diagnosis.odometry
    tick_m = 2 * np.pi * odometry["wheel_radius_m"] / odometry["ticks_per_rev"]
    assumed = {"track_m": odometry["track_m"], "reading_ratio": 1.0, "wheel_ratio": 1.0, "tick_m": tick_m}
    rows = []
    for name, quantity in QUANTITIES.items():
        estimate, smallest = diagnosis.quantities[name], least[quantity.fault]
        if quantity.fault == "track":
            smallest *= odometry["track_m"]
        off = "+-" if quantity.fault in {"track", "radius", "wheel"} else ""
        right = _write(assumed.get(name, 0.0), quantity)
        rows.append([quantity.title, *_tell(estimate, quantity), right, off + _write(smallest, quantity)])
    return rows


def write_markdown(diagnosis: Diagnosis) -> str:
    """The page in Markdown."""
    faults = find_faults(diagnosis)
    blocks = ["# What is wrong with these wheels", *_list_findings(diagnosis, faults)]
    blocks += [tabulate(HEADINGS, list_rows(diagnosis)), _say_how(diagnosis), UNKNOWN_SCALE_NOTE]
    return "\n\n".join(blocks) + "\n"


def print_diagnosis(diagnosis: Diagnosis, console: Console) -> None:
    """Print the page: faults, then the table, then what cannot be known."""
    faults = find_faults(diagnosis)
    style = "green" if not faults and _is_measured(diagnosis) else "yellow"
    say(console, *(f"{line}\n" for line in _list_findings(diagnosis, faults)), style=style)
    print_table(console, HEADINGS, list_rows(diagnosis))
    say(console, f"\n{_say_how(diagnosis)}", f"\n{UNKNOWN_SCALE_NOTE}")


def print_wheels(wheels: Wheels, assumed: Sequence[float], settings: EncoderSettings, console: Console) -> None:
    """Print constants and noise by a tracker, errors of gaps and of ends of runs left out, and the settings."""
    rows = [[one.title, *_tell(wheels.intervals[name], one)] for name, one in REAL_QUANTITIES.items()]
    print_table(console, HEADINGS[:3], rows)
    left, right, track = (one / true for one, true in zip(assumed, wheels.model, strict=False))
    drift, turn = (right - left) / assumed[2] / DEG, (left + right) / 2 / track - 1
    lines = ["", f"As assumed, headings drift by {drift:+.2f} degrees a metre, and turns are {turn:+.1%} off."]
    for length, gaps in wheels.gaps.items():
        error, model = list_errors(gaps)["along"][0], wheels.model.expect_spread(length)
        spread = measure_spread(error)
        beyond = 100 * (np.abs(error - np.median(error)) > 3.0 * spread).mean()
        both = f"{1000 * spread:.2f} mm, by the model and the tracker's {1000 * model:.2f}"
        lines.append(
            f"Gaps of {100 * length:g} cm: error {both}; beyond three deviations {beyond:.1f} % (normal: 0.3 %)"
        )
    if wheels.ends_m:
        before, after = np.transpose(list(wheels.ends_m.values()))
        ratio = f"{(after / before).mean():.2f} times as far off as assumed ({len(before)} parts, each its median)"
        lines += ["", f"Ends of runs left out in turn are {ratio}."]
    written = [f"  {name}: {value:.4g}" for name, value in settings.model_dump(exclude_defaults=True).items()]
    say(console, *lines, "", "In the simulator:", "encoder:", *written)


def _is_measured(diagnosis: Diagnosis) -> bool:
    return diagnosis.track_m.known and diagnosis.wheel_ratio.known


def _list_findings(diagnosis: Diagnosis, faults: Sequence[Finding]) -> list[str]:
    if not faults:
        return [NO_FAULT_NOTE if _is_measured(diagnosis) else TOO_SHORT_NOTE]
    return [
        f"{number}. {one.text}\n   Set: {one.cure}.\n   In the simulator: {one.setting}"
        for number, one in enumerate(faults, start=1)
    ]


def _say_how(diagnosis: Diagnosis) -> str:
    if not _is_measured(diagnosis):
        return f"Only {diagnosis.turns} turns and {diagnosis.pairs} pairs of images could be used: drive longer."
    return (
        f"By {diagnosis.turns} turns in place, {diagnosis.pairs} pairs of images of about one place, and the readings; "
        "the noise of a gap is found from the times of readings, so changes of the robot's speed add to it."
    )


def _tell(estimate: Estimate, quantity: Quantity) -> tuple[str, str]:
    if not estimate.known:
        return "-", "unknown"
    low, high = (_write(value, quantity, "") for value in (estimate.low, estimate.high))
    return _write(estimate.value, quantity), f"{low} to {high}"


def _write(value: float, quantity: Quantity, unit: str | None = None) -> str:
    unit = quantity.unit if unit is None else unit
    return f"{value / quantity.size:.{quantity.decimals}f} {unit}".strip()


def describe_encoders(recording: Recording, pose: np.ndarray, drift: np.ndarray) -> str:
    """Describe the encoders' settings and their measured errors as Markdown.

    True poses (N, 3) are at observations; ``drift`` is how far the dead-reckoned path is off (R,) [m].
    """
    length, error = measure_segments(recording, pose)
    odometry = recording.manifest.odometry
    tick_mm = 1000 * measure_tick(odometry)
    driven_m = recording.manifest.distance_driven_m or length.sum()
    measured = {
        "one tick": f"{tick_mm:.3g} mm",
        "segments": f"{len(length)}, {driven_m:.0f} m in total",
        "RMS error of a segment": f"{1000 * np.sqrt(np.mean(error**2)):.3g} mm",
        "mean error": f"{1000 * error.mean():+.3g} mm",
        "largest error": f"{1000 * np.abs(error).max():.3g} mm",
        "encoder / true distance": f"{1 + error.sum() / length.sum():.4f}",
        "drift of the dead-reckoned path from its start": f"{drift[-1]:.2f} m at the end, {drift.max():.2f} m at most",
    }
    rows = [[name, value] for name, value in measured.items()]
    shown = (
        "Above: the true path (blue) and the dead-reckoned path (orange) of the last two minutes; the red line joins "
        "the two positions at the current time."
    )
    return "\n\n".join(["## Encoder measurements", list_faults(recording), tabulate(["measured", ""], rows), shown])


def list_faults(recording: Recording) -> str:
    """A Markdown table of faults and settings that differ from faultless encoders, or a sentence that none differs."""
    settings, ticks = recording.manifest.settings, recording.manifest.odometry["ticks_per_rev"]
    sound = {f"encoder.{name}": value for name, value in EncoderSettings().model_dump().items()}
    sound["robot.wheel_radius_error"] = RobotSettings().wheel_radius_error
    was_set = {
        f"{group}.{name}": value for group in ("encoder", "robot") for name, value in settings.get(group, {}).items()
    }
    was_set["encoder.ticks_per_rev"] = ticks
    for name, strength in settings.get("encoder", {}).get("plugins", {}).items():
        sound[f"encoder.plugins.{name}"], was_set[f"encoder.plugins.{name}"] = 0.0, strength
    rows = [
        [name, f"**{value}**", str(sound[name])]
        for name, value in was_set.items()
        if name in sound and value != sound[name]
    ]
    if not rows:
        return f"No faults are set: {ticks} ticks per revolution, all of them correct."
    return tabulate(["fault or setting", "this run", "default"], rows)


def draw_segments(length: np.ndarray, error: np.ndarray) -> Figure:
    """Plot the error of each segment (S,) [m] against its length (S,) [m], next to a histogram of the errors.

    The line is the RMS error of segments of similar length.
    """
    with style.context("dark_background"):
        figure = Figure(figsize=(9, 3.6), layout="constrained", facecolor=SCREEN[0])
        cloud, counts = figure.subplots(1, 2, sharey=True, width_ratios=[5, 2])
        error_mm = 1000 * error
        cloud.axhline(0, color="#888888", linewidth=0.8)
        cloud.scatter(length, error_mm, s=9, color=ENCODER_COLOUR, alpha=0.6, linewidths=0)
        order = np.array_split(np.argsort(length), min(10, len(length)))
        middle = [length[part].mean() for part in order]
        rms = np.array([np.sqrt(np.mean(error_mm[part] ** 2)) for part in order])
        cloud.plot(middle, rms, color=TRUE_COLOUR, linewidth=1.6, label="± RMS of segments of similar length")
        cloud.plot(middle, -rms, color=TRUE_COLOUR, linewidth=1.6)
        cloud.set(xlabel="length of the segment [m]", ylabel="encoder minus truth [mm]", xlim=(0, None))
        cloud.legend(frameon=False, loc="upper left", fontsize=9)
        counts.hist(error_mm, bins=40, orientation="horizontal", color=ENCODER_COLOUR, alpha=0.8)
        counts.set(xlabel="segments")
        for axes in (cloud, counts):
            axes.set_facecolor(SCREEN[0])
            axes.grid(alpha=0.15)
            axes.spines[["top", "right"]].set_visible(False)
        rms_mm = np.sqrt(np.mean(error_mm**2))
        figure.suptitle(
            f"Error of {len(error)} segments: RMS {rms_mm:.3g} mm, mean {error_mm.mean():+.3g} mm", fontsize=12
        )
    return figure
