"""The encoders' measurements of a drive against the truth: each segment's error, configured faults, and drift."""

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure

from deepgps.evaluation.segment_errors import measure_segments
from deepgps.reports.style import SCREEN
from sim.recording.format import Recording
from sim.sensors.encoder import measure_tick
from sim.settings import EncoderSettings, RobotSettings

ENCODER, TRUE = "#ff9628", "#5aa0ff"


def describe_encoders(recording: Recording, pose: np.ndarray, drift: np.ndarray) -> str:
    """Describe the encoders' settings and their measured errors as Markdown.

    Args:
        recording: The recording.
        pose: True pose at each observation (N, 3).
        drift: Distance of the dead-reckoned path from the true one (R,) [m].
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
    return "\n".join(
        [
            "## Encoder measurements",
            "",
            *list_faults(recording),
            "",
            "| measured | |",
            "|---|---|",
            *(f"| {name} | {value} |" for name, value in measured.items()),
            "",
            "Above: the true path (blue) and the dead-reckoned path (orange) of the last two minutes; the red line "
            "joins the two positions at the current time.",
        ]
    )


def list_faults(recording: Recording) -> list[str]:
    """A Markdown table of faults and settings that differ from faultless encoders, or a sentence that none differs."""
    settings = recording.manifest.settings
    ticks = recording.manifest.odometry["ticks_per_rev"]
    sound = {f"encoder.{name}": value for name, value in EncoderSettings().model_dump().items()}
    sound["robot.wheel_radius_error"] = RobotSettings().wheel_radius_error
    was_set = {
        f"{group}.{name}": value for group in ("encoder", "robot") for name, value in settings.get(group, {}).items()
    }
    was_set["encoder.ticks_per_rev"] = ticks
    for name, setting in settings.get("encoder", {}).get("plugins", {}).items():
        sound[f"encoder.plugins.{name}"], was_set[f"encoder.plugins.{name}"] = 0.0, setting["value"]
    faults = {name: value for name, value in was_set.items() if name in sound and value != sound[name]}
    if not faults:
        return [f"No faults are set: {ticks} ticks per revolution, all of them correct."]
    rows = (f"| {name} | **{value}** | {sound[name]} |" for name, value in faults.items())
    return ["| fault or setting | this run | default |", "|---|---:|---:|", *rows]


def draw_segments(length: np.ndarray, error: np.ndarray) -> Figure:
    """Plot the error of each segment (S,) [m] against its length (S,) [m], next to a histogram of the errors.

    The line is the RMS error of segments of similar length.
    """
    with style.context("dark_background"):
        figure = Figure(figsize=(9, 3.6), layout="constrained", facecolor=SCREEN[0])
        cloud, counts = figure.subplots(1, 2, sharey=True, width_ratios=[5, 2])
        error_mm = 1000 * error
        cloud.axhline(0, color="#888888", linewidth=0.8)
        cloud.scatter(length, error_mm, s=9, color=ENCODER, alpha=0.6, linewidths=0)
        middle, rms = _rms_along(length, error_mm)
        cloud.plot(middle, rms, color=TRUE, linewidth=1.6, label="± RMS of segments of similar length")
        cloud.plot(middle, -rms, color=TRUE, linewidth=1.6)
        cloud.set(xlabel="length of the segment [m]", ylabel="encoder minus truth [mm]", xlim=(0, None))
        cloud.legend(frameon=False, loc="upper left", fontsize=9)
        counts.hist(error_mm, bins=40, orientation="horizontal", color=ENCODER, alpha=0.8)
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


def _rms_along(length: np.ndarray, error: np.ndarray, parts: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Mean length and RMS error of groups of equally many segments, from short to long."""
    order = np.array_split(np.argsort(length), min(parts, len(length)))
    mean = np.array([length[part].mean() for part in order])
    return mean, np.array([np.sqrt(np.mean(error[part] ** 2)) for part in order])
