"""Sweeps of encoder faults: rows in which one fault grows from zero, and pairs of faults that grow together."""

from collections.abc import Sequence
from typing import NamedTuple

from deepgps.config.methods import title_of
from deepgps.reports.targets import Figure, compare_means, mean_of
from deepgps.studies.reports.columns import is_folded
from deepgps.studies.table import Row, split_by, split_by_label, varied_in
from sim.sensors.encoder import FAULTS
from sim.settings import EncoderSettings, RobotSettings

Names = tuple[str, ...]
UNEQUAL_WHEELS = "robot.wheel_radius_error"
PERFECT = {
    **{f"encoder.{name}": value for name, value in EncoderSettings().model_dump().items()},
    UNEQUAL_WHEELS: RobotSettings().wheel_radius_error,
}
"""Settings of encoders and wheels, and their values without faults."""
FEWER_IS_WORSE = "encoder.ticks_per_rev"
TITLES: dict[Names, str] = {
    (FEWER_IS_WORSE,): "ticks per revolution",
    ("encoder.radius_error_left",): "error of one wheel's radius",
    **{tuple(f"encoder.{name}" for name in fault.settings): fault.title for fault in FAULTS},
    (UNEQUAL_WHEELS,): "left wheel larger by this part: the robot curves",
}
NOISE, STUCK = "encoder.step_noise", "encoder.stuck_fraction"
STRONG = {"w": (NOISE, 0.3), "radius": ("encoder.radius_error_left", 0.01), "slip": ("encoder.slip_per_m", 0.1)}
"""Faults under which the compass is compared with DeepGPS, which ignores turns, by the names of the figures."""
STUCK_HALF, CURVES = 0.5, (0.01, 0.03)


class Sweep(NamedTuple):
    """Rows in which one fault grows from zero.

    Attributes:
        names: Settings that grow together.
        rows: Measured rows of all methods and seeds, at each value.
    """

    names: Names
    rows: list[Row]

    @property
    def title(self) -> str:
        """The fault that grows, in words."""
        return TITLES[self.names]

    def by_value(self, method: str) -> dict[float, list[Row]]:
        """Rows of a method by the value of the fault, the smallest fault first."""
        rows = split_by([row for row in self.rows if row["method"] == method], self.names[0])
        sign = -1 if self.names[0] == FEWER_IS_WORSE else 1
        return dict(sorted(rows.items(), key=lambda one: sign * abs(one[0])))


def find_sweeps(rows: Sequence[Row]) -> list[Sweep]:
    """A sweep for every fault that grows alone, including the rows without any fault."""
    groups = split_by_label(rows, _list_changed)
    perfect = groups.get((), [])
    # both radii grow together only where they are the same
    return [
        Sweep(names, [*perfect, *(row for row in groups[names] if len(set(_values(row, names))) == 1)])
        for names in TITLES
        if names in groups
    ]


def find_pairs(rows: Sequence[Row]) -> list[Names]:
    """Every pair of faults that vary together but are not one sweep."""
    pairs = sorted({names for row in rows if len(names := _list_changed(row)) == 2})
    return [pair for pair in pairs if pair not in TITLES]


def split_by_values(rows: Sequence[Row], names: Names) -> dict[tuple[float, ...], list[Row]]:
    """Rows of a pair of faults by their values: both faults set, each of these values alone, and no fault."""
    both = [_values(row, names) for row in rows if _list_changed(row) == names]
    asked = [{PERFECT[name], *(values[place] for values in both)} for place, name in enumerate(names)]
    ours = [
        row
        for row in rows
        if set(_list_changed(row)) <= set(names)
        and all(value in known for value, known in zip(_values(row, names), asked, strict=True))
    ]
    return dict(sorted(split_by_label(ours, lambda row: _values(row, names)).items()))


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Both variants of DeepGPS at w = 0.10, 16 and 4 ticks; the compass beside DeepGPS, stuck, and on curves."""
    sweeps, figures = {sweep.names: sweep for sweep in find_sweeps(rows)}, {}

    def find(method: str, setting: str, value: float) -> list[Row]:
        """A method's rows in which this setting alone has this value; none if nothing else was measured."""
        return sweeps[setting,].by_value(method).get(value, []) if (setting,) in sweeps else []

    for method, prefix in (("deepgps", ""), ("deepgps_noise_aware", "aware_")):
        title, perfect = title_of(method), find(method, FEWER_IS_WORSE, PERFECT[FEWER_IS_WORSE])
        if group := find(method, NOISE, 0.1):
            figures[f"{prefix}rms_w"] = mean_of(f"RMS at w = 0.10, {title}", [row["rms_m"] for row in group], "cm")
        for ticks in (16, 4):
            if (group := find(method, FEWER_IS_WORSE, ticks)) and perfect:
                words = f"RMS at {ticks} ticks / perfect, {title}"
                figures[f"{prefix}ticks_{ticks}"] = compare_means(words, group, perfect, "rms_m")
    method = "deepgps_compass"
    title = title_of(method)
    for key, (setting, value) in STRONG.items():
        ours, alone = (find(name, setting, value) for name in (method, "deepgps"))
        if ours and alone:
            words = f"{title}: RMS / {title_of('deepgps')}'s, {TITLES[(setting,)]} {value:g}"
            figures[f"compass_{key}"] = compare_means(words, ours, alone, "rms_m")
    if stuck := find(method, STUCK, STUCK_HALF):
        words = f"{title}: RMS, one encoder stuck for half of the drive"
        figures["compass_stuck_rms_m"] = mean_of(words, [row["rms_m"] for row in stuck], "cm")
        words = f"{title}: maps folded of {len(stuck)}, one encoder stuck for half of the drive"
        figures["compass_stuck_folded"] = Figure(words, sum(map(is_folded, stuck)), "count")
    straight = find(method, UNEQUAL_WHEELS, 0.0)
    for value in CURVES:
        if (group := find(method, UNEQUAL_WHEELS, value)) and straight:
            words = f"{title}: median / without faults, left wheel larger by {100 * value:g} %"
            figures[f"compass_curves_{100 * value:g}"] = compare_means(words, group, straight, "median_m")
    return figures


def _values(row: Row, names: Names) -> tuple[float, ...]:
    return tuple(row[name] for name in names)


def _list_changed(row: Row) -> Names:
    return tuple(sorted(name for name in varied_in(row) if name in PERFECT and row[name] != PERFECT[name]))
