"""The sliders of a study: for each thing that varies a timeline of runs in which nothing else does."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from deepgps.studies.grouping import shorten
from deepgps.studies.table import Row, split_by, tell_apart, varied_in

CASE, SEED, RUN = "case", "seed", "run"
NO_CHANGE = "no change"  # a case with the scenario's own settings
Point = tuple[tuple[Any, ...], ...]  # values of each dimension: case, axes, seed


@dataclass(frozen=True)
class Step:
    """One place on a slider.

    Attributes:
        value: What stands there, in words.
        words: What sets the run that is shown apart from all others, in words.
        rows: The run that is shown, a row for each method; of runs that differ in their seed, the first that is done.
        repeats: Rows of all seeds that are done.
    """

    value: str
    words: str
    rows: Sequence[Row]
    repeats: Sequence[Row]

    @property
    def done(self) -> bool:
        """Whether there is a run to show."""
        return self.rows[0]["failure"] is None


@dataclass(frozen=True)
class Slider:
    """One timeline.

    Attributes:
        name: The setting that it moves, or ``case``, ``seed`` or ``run``.
        steps: Its places in order.
        others: What stays as it is meanwhile, in words.
    """

    name: str
    steps: Sequence[Step]
    others: str


def find_sliders(rows: Sequence[Row], axes: Sequence[str], own: Mapping[str, Any]) -> list[Slider]:
    """Sliders of a study, the one to open with first.

    An axis has a slider of its own, and so have cases and seeds where there are several; all else keeps its base value:
    the scenario's own where the study has it, the first elsewhere. Where several things vary, ``run`` goes through all.
    Where the scenario's own settings are one of many cases, the others are named by what they set otherwise, and a
    setting to which some of the cases give several values, and change nothing else, has a slider as an axis has.

    Args:
        rows: The study's table.
        axes: Names of its axes; whatever else varies does so by cases.
        own: The scenario's own values by dotted name.
    """
    runs = list(split_by(rows, "run").values())
    names = varied_in(rows[0])
    axes = [name for name in names if name in axes]
    cases = tell_apart(rows, [name for name in names if name not in axes])
    dimensions = {CASE: cases, **{name: [name] for name in axes}, SEED: [SEED]}
    at = {_locate(group[0], dimensions): group for group in runs}
    values = {name: _order({point[place]: None for point in at}) for place, name in enumerate(dimensions)}
    base = {name: _choose(values[name], [own.get(column) for column in dimensions[name]]) for name in dimensions}
    among = len(cases) > 1 and list(base[CASE]) == [own.get(column) for column in cases]
    usual = dict(zip(cases, base[CASE], strict=True)) if among else {}
    moving = [name for name in _rank(dimensions) if len(values[name]) > 1]
    sliders = []
    for name in moving:
        if name == CASE:
            texts = {case: describe(cases, case, usual) or NO_CHANGE for case in values[CASE]}
        else:
            texts = {value: write(value[0]) for value in values[name]}
        sliders.append(_make(name, name, texts, values[SEED], base, dimensions, at, usual))
        alone = _find_alone(cases, values[CASE], usual) if name == CASE else {}
        for setting, texts in alone.items():
            sliders.append(_make(setting, CASE, texts, values[SEED], base, dimensions, at, usual))
    if len(moving) != 1:
        steps = [_make_step(dimensions, "", [group], usual) for group in runs]
        sliders.append(Slider(RUN, steps, ""))
    return sliders


def describe(names: Sequence[str], values: Sequence[Any], usual: Mapping[str, Any]) -> str:
    """Settings in words: text as it is, numbers and flags with their names; what is as usual is left out."""
    told = zip(names, shorten([*names, SEED]), values, strict=False)  # a room's seed is not the run's
    return ", ".join(
        value if isinstance(value, str) else f"{short} {write(value)}"
        for name, short, value in told
        if name not in usual or value != usual[name]
    )


def write(value: Any) -> str:
    """A setting's value as people write it."""
    if value is None or isinstance(value, bool):
        return {None: "none", True: "yes", False: "no"}[value]
    return f"{value:g}" if isinstance(value, int | float) and abs(value) < 1e6 else str(value)


def _make(
    name: str,
    dimension: str,
    texts: Mapping[tuple, str],
    seeds: Sequence[tuple],
    base: Mapping[str, tuple],
    dimensions: Mapping[str, Sequence[str]],
    at: Mapping[Point, Sequence[Row]],
    usual: Mapping[str, Any],
) -> Slider:
    """A slider that moves a dimension through values, each with its text, while all else keeps its base value."""
    steps = []
    for value, text in texts.items():
        point = {**base, dimension: value}
        tried = [point[SEED], *(seed for seed in seeds if seed != point[SEED])] if dimension != SEED else [value]
        there = [at[place] for seed in tried if (place := tuple({**point, SEED: seed}.values())) in at]
        if there:
            steps.append(_make_step(dimensions, text, there, usual))
    others = [describe(dimensions[other], base[other], usual) for other in dimensions if other != dimension]
    return Slider(name, steps, ", ".join(text for text in others if text))


def _find_alone(names: Sequence[str], cases: Sequence[tuple], usual: Mapping[str, Any]) -> dict[str, dict[tuple, str]]:
    """Settings that have three values or more in cases where all else is as usual: those cases, each with its value."""
    found = {}
    for place, name in enumerate(names if usual else ()):
        alone = [case for case in cases if all(case[k] == usual[other] for k, other in enumerate(names) if k != place)]
        if 2 < len(alone) < len(cases):
            by_value = {(case[place],): case for case in alone}
            found[name] = {by_value[value]: write(value[0]) for value in _order(dict.fromkeys(by_value))}
    return found


def _make_step(
    dimensions: Mapping[str, Sequence[str]], value: str, runs: Sequence[Sequence[Row]], usual: Mapping[str, Any]
) -> Step:
    done = [group for group in runs if group[0]["failure"] is None]
    shown = (done or runs)[0]
    names = [name for names in dimensions.values() for name in names]
    values = [shown[0][name] for name in names]
    repeats = [row for group in done for row in group]
    return Step(value or describe(names, values, usual), describe(names, values, {}), shown, repeats)


def _locate(row: Row, dimensions: Mapping[str, Sequence[str]]) -> Point:
    return tuple(tuple(row[name] for name in names) for names in dimensions.values())


def _order(values: Mapping[tuple, None]) -> list[tuple]:
    """Numbers by size, so that a slider goes one way; all else as the study lists it."""
    numbers = all(len(value) == 1 and isinstance(value[0], int | float) for value in values)
    return sorted(values) if numbers else list(values)


def _choose(values: Sequence[tuple], own: Sequence[Any]) -> tuple:
    """The scenario's own value where it is among them, the first elsewhere."""
    return next((value for value in values if list(value) == own), values[0])


def _rank(dimensions: Mapping[str, Sequence[str]]) -> list[str]:
    """What is worth looking at comes first: the last axis, along which curves run, and seeds at the end."""
    axes = [name for name in dimensions if name not in (CASE, SEED)]
    repeats = [name for name in axes if name.endswith(SEED)]
    return [*(name for name in reversed(axes) if name not in repeats), CASE, *repeats, SEED]
