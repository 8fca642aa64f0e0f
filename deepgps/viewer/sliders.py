"""The sliders of a study: for each setting that varies, a timeline of runs in which nothing else varies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from deepgps.studies.table import Row, shorten, split_by, tell_apart, varied_in

CASE, SEED, RUN = "case", "seed", "run"
MAX_DIGITS = 6
NO_CHANGE = "no change"  # a case with the scenario's own settings
Point = tuple[tuple[Any, ...], ...]  # values of each dimension: case, axes, seed


@dataclass(frozen=True)
class Step:
    """One place on a slider."""

    value: str  # The setting's value at this place, in words
    words: str  # What distinguishes the run shown here from all others, in words
    # Rows of the run shown here, one for each method; of runs that differ in seed, the first finished one
    rows: Sequence[Row]
    repeats: Sequence[Row]  # Rows of all finished seeds
    number: float | None = None  # The setting's value, if it is a number

    @property
    def done(self) -> bool:
        """Whether there is a finished run to show."""
        return self.rows[0]["failure"] is None


@dataclass(frozen=True)
class Slider:
    """One timeline."""

    name: str  # The setting that the slider changes, or ``case``, ``seed`` or ``run``
    steps: Sequence[Step]  # The slider's places in order
    others: str  # The settings that stay fixed, in words

    @property
    def numbers(self) -> list[float]:
        """The setting's values; empty unless all are numbers."""
        numbers = [step.number for step in self.steps if step.number is not None]
        return numbers if len(numbers) == len(self.steps) else []

    @property
    def timeline(self) -> str:
        """Name of the timeline, with the unit of its values where they are fractions: ``noise [1/100]``."""
        return self.name if self._per_unit == 1 else f"{self.name} [1/{self._per_unit}]"

    @property
    def places(self) -> list[int]:
        """Place of each step on the timeline: the setting's value in its unit, or a number from 1."""
        scaled = [number * self._per_unit for number in self.numbers]
        if scaled and all(map(_is_whole, scaled)):
            return [round(number) for number in scaled]
        return list(range(1, len(self.steps) + 1))

    @property
    def _per_unit(self) -> int:
        """The smallest power of ten that makes all values whole numbers; 1 where none of reasonable size does."""
        units = (10**power for power in range(MAX_DIGITS + 1))
        return next((unit for unit in units if all(_is_whole(number * unit) for number in self.numbers)), 1)


def find_sliders(rows: Sequence[Row], axes: Sequence[str], own: Mapping[str, Any]) -> list[Slider]:
    """Find the sliders of a study's rows; the viewer opens with the first.

    Each axis with several values has a slider, as have cases and seeds if there are several. While a slider moves, all
    other dimensions keep their base value: the scenario's ``own`` value if it occurs in the study, otherwise the first
    one. The slider ``run`` goes through all runs unless exactly one dimension varies. If the scenario's own settings
    are one of several cases, the other cases are named by the settings that differ. A setting with three or more values
    in cases that change nothing else then also has a slider.
    """
    runs = list(split_by(rows, "run").values())
    names = varied_in(rows[0])
    axes = [name for name in names if name in axes]
    cases = tell_apart(rows, [name for name in names if name not in axes])
    dimensions = {CASE: cases, **{name: [name] for name in axes}, SEED: [SEED]}
    at = {tuple(tuple(group[0][one] for one in some) for some in dimensions.values()): group for group in runs}
    values = {name: _order({point[place]: None for point in at}) for place, name in enumerate(dimensions)}
    base = {name: _choose(values[name], [own.get(column) for column in dimensions[name]]) for name in dimensions}
    among = len(cases) > 1 and list(base[CASE]) == [own.get(column) for column in cases]
    usual = dict(zip(cases, base[CASE], strict=True)) if among else {}
    design = _Design(dimensions, at, base, values[SEED], usual)
    moving = [name for name in _rank(dimensions) if len(values[name]) > 1]
    sliders = []
    for name in moving:
        if name == CASE:
            texts = {case: describe(cases, case, usual) or NO_CHANGE for case in values[CASE]}
            alone = _find_alone(cases, values[CASE], usual)
        else:
            texts, alone = {value: write(value[0]) for value in values[name]}, {}
        sliders.append(design.make_slider(name, name, texts))
        sliders += [design.make_slider(setting, CASE, texts) for setting, texts in alone.items()]
    if len(moving) != 1:
        sliders.append(Slider(RUN, [design.make_step("", [group]) for group in runs], ""))
    return sliders


def describe(names: Sequence[str], values: Sequence[Any], usual: Mapping[str, Any]) -> str:
    """Describe settings in words: text as it is, numbers and flags with their names; usual values are left out."""
    shown = zip(names, shorten([*names, SEED]), values, strict=False)  # SEED keeps a room's seed apart from the run's
    return ", ".join(
        value if isinstance(value, str) else f"{short} {write(value)}"
        for name, short, value in shown
        if name not in usual or value != usual[name]
    )


def write(value: Any) -> str:
    """Write a setting's value for people to read."""
    if value is None or isinstance(value, bool):
        return {None: "none", True: "yes", False: "no"}[value]
    return f"{value:g}" if isinstance(value, int | float) and abs(value) < 1e6 else str(value)


@dataclass(frozen=True)
class _Design:
    """A study's runs at their values of all dimensions; ``base`` is what a dimension keeps while another one moves."""

    dimensions: Mapping[str, Sequence[str]]
    at: Mapping[Point, Sequence[Row]]
    base: Mapping[str, tuple]
    seeds: Sequence[tuple]
    usual: Mapping[str, Any]

    def make_slider(self, name: str, dimension: str, texts: Mapping[tuple, str]) -> Slider:
        """Make a slider that moves a dimension through values, each with its text."""
        steps = []
        for value, text in texts.items():
            point = {**self.base, dimension: value}
            others = [seed for seed in self.seeds if seed != point[SEED] and dimension != SEED]
            places = [tuple({**point, SEED: seed}.values()) for seed in (point[SEED], *others)]
            if there := [self.at[place] for place in places if place in self.at]:
                is_number = len(value) == 1 and isinstance(value[0], int | float) and not isinstance(value[0], bool)
                steps.append(replace(self.make_step(text, there), number=value[0] if is_number else None))
        kept = [describe(self.dimensions[one], self.base[one], self.usual) for one in self.base if one != dimension]
        return Slider(name, steps, ", ".join(text for text in kept if text))

    def make_step(self, value: str, runs: Sequence[Sequence[Row]]) -> Step:
        """Make a step of the first finished one of some runs; without a value in words, all its settings are named."""
        done = [group for group in runs if group[0]["failure"] is None]
        shown = (done or runs)[0]
        names = [name for names in self.dimensions.values() for name in names]
        values = [shown[0][name] for name in names]
        repeats = [row for group in done for row in group]
        return Step(value or describe(names, values, self.usual), describe(names, values, {}), shown, repeats)


def _find_alone(names: Sequence[str], cases: Sequence[tuple], usual: Mapping[str, Any]) -> dict[str, dict[tuple, str]]:
    """Cases, each with its value, of every setting with three or more values in cases where all else is as usual."""
    found = {}
    for place, name in enumerate(names if usual else ()):
        alone = [case for case in cases if all(case[k] == usual[other] for k, other in enumerate(names) if k != place)]
        if 2 < len(alone) < len(cases):
            by_value = {(case[place],): case for case in alone}
            found[name] = {by_value[value]: write(value[0]) for value in _order(dict.fromkeys(by_value))}
    return found


def _order(values: Mapping[tuple, None]) -> list[tuple]:
    """Sort numbers, so that a slider is monotonic; keep all else in the study's order."""
    numbers = all(len(value) == 1 and isinstance(value[0], int | float) for value in values)
    return sorted(values) if numbers else list(values)


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) < 1e-9 * max(abs(number), 1.0) and abs(number) < 2**53


def _choose(values: Sequence[tuple], own: Sequence[Any]) -> tuple:
    """The scenario's own value if it is among the values, otherwise the first."""
    return next((value for value in values if list(value) == own), values[0])


def _rank(dimensions: Mapping[str, Sequence[str]]) -> list[str]:
    """Dimensions by interest: the last axis, along which curves run, comes first, and seeds come last."""
    axes = [name for name in dimensions if name not in (CASE, SEED)]
    repeats = [name for name in axes if name.endswith(SEED)]
    return [*(name for name in reversed(axes) if name not in repeats), CASE, *repeats, SEED]
