"""Sweeps of encoder faults: rows in which one fault grows from zero, and pairs of faults that grow together."""

from collections.abc import Sequence
from typing import NamedTuple

from deepgps.studies.table import Row, split_by, varied_in
from sim.sensors.encoder_faults import FAULTS
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
    changed = {_changed(row) for row in rows}
    perfect = [row for row in rows if not _changed(row)]
    alone = [names for names in TITLES if names in changed]
    # both radii grow together only where they are the same
    return [
        Sweep(
            names, [*perfect, *(row for row in rows if _changed(row) == names and len(set(_values(row, names))) == 1)]
        )
        for names in alone
    ]


def find_pairs(rows: Sequence[Row]) -> list[Names]:
    """Every pair of faults that vary together but are not one sweep."""
    pairs = sorted({names for row in rows if len(names := _changed(row)) == 2})
    return [pair for pair in pairs if pair not in TITLES]


def split_by_values(rows: Sequence[Row], names: Names) -> dict[tuple[float, ...], list[Row]]:
    """Rows of a pair of faults by their values: both faults set, each of these values alone, and no fault."""
    both = [_values(row, names) for row in rows if _changed(row) == names]
    asked = [{PERFECT[name], *(values[place] for values in both)} for place, name in enumerate(names)]
    groups: dict[tuple[float, ...], list[Row]] = {}
    for row in rows:
        values = _values(row, names)
        if set(_changed(row)) <= set(names) and all(value in some for value, some in zip(values, asked, strict=True)):
            groups.setdefault(values, []).append(row)
    return dict(sorted(groups.items()))


def _values(row: Row, names: Names) -> tuple[float, ...]:
    return tuple(row[name] for name in names)


def _changed(row: Row) -> Names:
    """Settings of encoders and wheels that differ from their defaults."""
    return tuple(sorted(name for name in varied_in(row) if name in PERFECT and row[name] != PERFECT[name]))
