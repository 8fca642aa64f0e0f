"""Sweeps of encoder faults: rows in which one fault grows from zero, and pairs of faults that grow together."""

from collections.abc import Sequence
from typing import NamedTuple

from deepgps.studies.table import Row, split_by, varied_in
from sim.sensors.encoder_faults import FAULTS
from sim.settings import EncoderSettings

PERFECT = EncoderSettings()
Names = tuple[str, ...]
TITLES: dict[Names, str] = {
    ("ticks_per_rev",): "ticks per revolution",
    ("radius_error_left",): "error of one wheel's radius",
    **{fault.settings: fault.title for fault in FAULTS},
}
FEWER_IS_WORSE = "ticks_per_rev"


class Sweep(NamedTuple):
    """Rows in which one fault grows from zero.

    Attributes:
        names: Settings of the encoder that grow together.
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
        rows = split_by([row for row in self.rows if row["method"] == method], f"encoder.{self.names[0]}")
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
    asked = [{getattr(PERFECT, name), *(values[place] for values in both)} for place, name in enumerate(names)]
    groups: dict[tuple[float, ...], list[Row]] = {}
    for row in rows:
        values = _values(row, names)
        if set(_changed(row)) <= set(names) and all(value in some for value, some in zip(values, asked, strict=True)):
            groups.setdefault(values, []).append(row)
    return dict(sorted(groups.items()))


def _values(row: Row, names: Names) -> tuple[float, ...]:
    return tuple(row[f"encoder.{name}"] for name in names)


def _changed(row: Row) -> Names:
    """Settings of the encoder that differ from their defaults."""
    names = [name.removeprefix("encoder.") for name in varied_in(row) if name.startswith("encoder.")]
    return tuple(sorted(name for name in names if row[f"encoder.{name}"] != getattr(PERFECT, name)))
