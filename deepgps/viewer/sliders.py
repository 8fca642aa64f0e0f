"""The sliders of a study: for each setting that varies, a timeline of runs in which nothing else varies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from deepgps.studies.table import Row, shorten, split_by, tell_apart, varied_in

CASE, SEED, RUN = "case", "seed", "run"
NO_CHANGE = "no change"  # a case with the scenario's own settings


@dataclass(frozen=True)
class Step:
    """One place on a slider."""

    value: str  # The setting's value at this place, in words
    words: str  # What distinguishes the run shown here from all others, in words
    # Rows of the run shown here, one for each method; of runs that differ in seed, the first finished one
    rows: Sequence[Row]
    repeats: Sequence[Row]  # Rows of all finished seeds


@dataclass(frozen=True)
class Slider:
    """One timeline."""

    name: str  # The setting that the slider changes, or ``case``, ``seed`` or ``run``
    steps: Sequence[Step]  # The slider's places in order
    others: str  # The settings that stay fixed, in words


def find_sliders(rows: Sequence[Row], axes: Sequence[str], own: Mapping[str, Any]) -> list[Slider]:
    """Find the sliders of a study's rows; the viewer opens with the first.

    Each axis with several values has a slider, as have cases and seeds if there are several. While a slider moves, all
    other dimensions keep their base value: the scenario's ``own`` value if it occurs in the study, otherwise the first
    one. The slider ``run`` goes through all runs unless exactly one dimension varies. If the scenario's own settings
    are one of several cases, the other cases are named by the settings that differ.
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
    every = [column for some in dimensions.values() for column in some]

    def make_step(value: str, there: Sequence[Sequence[Row]]) -> Step:
        """The first finished one of some runs; without a value in words, all its settings are named."""
        done = [group for group in there if group[0]["failure"] is None]
        shown = (done or there)[0]
        settings = [shown[0][column] for column in every]
        repeats = [row for group in done for row in group]
        return Step(value or describe(every, settings, usual), describe(every, settings, {}), shown, repeats)

    def make_slider(name: str) -> Slider:
        steps = []
        for value in values[name]:
            text = write(value[0]) if name != CASE else describe(cases, value, usual) or NO_CHANGE
            point = {**base, name: value}
            others = [seed for seed in values[SEED] if seed != point[SEED] and name != SEED]
            places = [tuple({**point, SEED: seed}.values()) for seed in (point[SEED], *others)]
            if there := [at[place] for place in places if place in at]:
                steps.append(make_step(text, there))
        kept = [describe(dimensions[one], base[one], usual) for one in base if one != name]
        return Slider(name, steps, ", ".join(text for text in kept if text))

    sliders = [make_slider(name) for name in _rank(dimensions) if len(values[name]) > 1]
    if len(sliders) != 1:
        sliders.append(Slider(RUN, [make_step("", [group]) for group in runs], ""))
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


def _order(values: Mapping[tuple, None]) -> list[tuple]:
    """Sort numbers, so that a slider is monotonic; keep all else in the study's order."""
    numbers = all(len(value) == 1 and isinstance(value[0], int | float) for value in values)
    return sorted(values) if numbers else list(values)


def _choose(values: Sequence[tuple], own: Sequence[Any]) -> tuple:
    """The scenario's own value if it is among the values, otherwise the first."""
    return next((value for value in values if list(value) == own), values[0])


def _rank(dimensions: Mapping[str, Sequence[str]]) -> list[str]:
    """Dimensions by interest: the last axis, along which curves run, comes first, and seeds come last."""
    axes = [name for name in dimensions if name not in (CASE, SEED)]
    repeats = [name for name in axes if name.endswith(SEED)]
    return [*(name for name in reversed(axes) if name not in repeats), CASE, *repeats, SEED]
