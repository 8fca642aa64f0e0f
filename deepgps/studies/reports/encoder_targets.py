"""The figures by which the study of encoders is judged: few ticks, noise, and faults that the compass must bear."""

from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.reports.targets import Figure, mean_of
from deepgps.studies.reports.encoder_sweeps import FEWER_IS_WORSE, PERFECT, TITLES, UNEQUAL_WHEELS, find_sweeps
from deepgps.studies.reports.seeds import is_folded
from deepgps.studies.table import Row, mean

NOISE, STUCK = "encoder.step_noise", "encoder.stuck_fraction"
STRONG = {"w": (NOISE, 0.3), "radius": ("encoder.radius_error_left", 0.01), "slip": ("encoder.slip_per_m", 0.1)}
"""Faults under which the compass is compared with DeepGPS, which ignores turns, by the names of the figures."""
STUCK_HALF, CURVES = 0.5, (0.01, 0.03)


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Both variants of DeepGPS at w = 0.10, 16 and 4 ticks; the compass beside DeepGPS, stuck, and on curves."""
    figures = {}
    for method, prefix in (("deepgps", ""), ("deepgps_noise_aware", "aware_")):
        title, perfect = title_of(method), _find(rows, method, FEWER_IS_WORSE, PERFECT[FEWER_IS_WORSE])
        if group := _find(rows, method, NOISE, 0.1):
            figures[f"{prefix}rms_w"] = mean_of(f"RMS at w = 0.10, {title}", [row["rms_m"] for row in group], "cm")
        for ticks in (16, 4):
            if (group := _find(rows, method, FEWER_IS_WORSE, ticks)) and perfect:
                figures[f"{prefix}ticks_{ticks}"] = _compare(f"RMS at {ticks} ticks / perfect, {title}", group, perfect)
    return figures | _measure_compass(rows)


def _measure_compass(rows: Sequence[Row]) -> dict[str, Figure]:
    figures, method = {}, "deepgps_compass"
    title = title_of(method)
    for key, (setting, value) in STRONG.items():
        ours, alone = (_find(rows, name, setting, value) for name in (method, "deepgps"))
        if ours and alone:
            words = f"{title}: RMS / {title_of('deepgps')}'s, {TITLES[(setting,)]} {value:g}"
            figures[f"compass_{key}"] = _compare(words, ours, alone)
    if stuck := _find(rows, method, STUCK, STUCK_HALF):
        words = f"{title}: RMS, one encoder stuck for half of the drive"
        figures["compass_stuck_rms_m"] = mean_of(words, [row["rms_m"] for row in stuck], "cm")
        words = f"{title}: maps folded of {len(stuck)}, one encoder stuck for half of the drive"
        figures["compass_stuck_folded"] = Figure(words, sum(map(is_folded, stuck)), "count")
    straight = _find(rows, method, UNEQUAL_WHEELS, 0.0)
    for value in CURVES:
        if (group := _find(rows, method, UNEQUAL_WHEELS, value)) and straight:
            words = f"{title}: median / without faults, left wheel larger by {100 * value:g} %"
            figures[f"compass_curves_{100 * value:g}"] = _compare(words, group, straight, "median_m")
    return figures


def _find(rows: Sequence[Row], method: str, setting: str, value: float) -> list[Row]:
    """A method's rows in which this setting alone has this value; none if nothing else was measured."""
    found = [sweep.by_value(method) for sweep in find_sweeps(rows) if sweep.names == (setting,)]
    return found[0].get(value, []) if found else []


def _compare(title: str, rows: Sequence[Row], others: Sequence[Row], name: str = "rms_m") -> Figure:
    return Figure(title, mean(rows, name) / mean(others, name), "")
