"""The study: one scenario, what varies in it, and the resulting runs, all checked before the first one starts."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from os.path import isfile
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, Field, ValidationError, model_validator

from deepgps.methods.catalog import find_method
from deepgps.plain_yaml import read_yaml
from deepgps.progress import Report, ignore
from deepgps.scenario import (
    LONGEST_NAME,
    MOST_VALUES,
    NAME,
    MethodName,
    Scenario,
    clean_name,
    find_settings,
    flatten,
    override_scenario,
)
from deepgps.scenario_digest import digest, digest_recording, read_room
from deepgps.setting_problems import MOST_PROBLEMS, describe_problems, join_problems
from deepgps.settings import one_of
from deepgps.studies.catalog import REPORTS
from sim.errors import InputError
from sim.paths import SCENARIOS, STUDIES
from sim.settings import Group
from sim.user_input import quote, shorten

ReportName = Annotated[str, one_of(REPORTS)]
MOST_RUNS = 10_000
MOST_WRONG = 500
"""Number of invalid runs after which planning stops."""
STRIDE = 100
"""Runs planned between two progress reports."""
Point = Annotated[dict[str, Any], AfterValidator(flatten)]


class Variation(Group):
    """What varies; in a study's ``tiny`` and ``full``, only the given fields replace the study's own."""

    methods: tuple[MethodName, ...] | None = None
    """Methods to train and compare; None: the scenario's own."""
    set: Point = Field(default_factory=dict)
    """Settings by dotted name, the same for all runs; a group given as a mapping sets those that it names."""
    cases: tuple[Point, ...] = Field(default=({},), min_length=1)
    """Explicit combinations of settings by dotted name; ``scenario`` names a scenario other than the study's own."""
    axes: dict[str, tuple[Any, ...]] = Field(default_factory=dict)
    """Values by dotted name; each case is run with every combination of these values."""
    seeds: tuple[int, ...] = Field(default=(0,), min_length=1)
    """Seeds of the scenario."""

    @model_validator(mode="after")
    def _each_name_varies_once(self) -> "Variation":
        varied = {name for case in self.cases for name in case}
        for name in ("seed", "name", "methods"):
            if name in {*self.set, *varied, *self.axes}:
                raise ValueError(f"{name} can be no name in set, cases or axes; a study has seeds, a name and methods")
        if both := [name for name in self.axes if name in varied]:
            raise ValueError(f"{shorten(both[0])} is both in cases and in axes")
        if empty := [name for name, values in self.axes.items() if not values]:
            raise ValueError(f"axes.{shorten(empty[0])} has no values")
        sources = [*(case["scenario"] for case in self.cases if "scenario" in case), *self.axes.get("scenario", ())]
        if wrong := [source for source in sources if not isinstance(source, str)]:
            raise ValueError(f"scenario {quote(wrong[0])} must be a name in assets/scenarios, or a path")
        return self


class Study(Variation):
    """One scenario and what varies in it."""

    name: str = Field(default="unnamed", pattern=NAME)
    """Name of the study; its folder is runs/studies/<name>. In a file without it, the file's own name, with _ for other
    letters than a name may hold."""
    scenario: str
    """A name in assets/scenarios, or the path of a YAML file, relative to the study's own folder."""
    report: ReportName = "plain"
    """How the table is reported (deepgps/studies/catalog.py). plain: rows as they are; rooms: means, and which method
    wins; compare: means over seeds for everything else that varies; curves: errors along the last axis, the default if
    that has numbers."""
    target: dict[str, float] = Field(default_factory=dict)
    """Target values of the report's figures."""
    paper: dict[str, float] = Field(default_factory=dict)
    """The paper's values of the report's figures."""
    tiny: Variation = Variation()
    """Fields that --tiny replaces; its ``set`` is added to the study's."""
    full: Variation | None = None
    """Fields that --full replaces for a long version; its ``set`` is added to the study's. None: no such version."""

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_drawn_as_curves(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or "report" in values or not isinstance(values.get("axes"), Mapping):
            return values
        last = [*values["axes"].values()][-1:]
        return {**values, "report": "curves"} if _are_numbers(last) else values

    @model_validator(mode="after")
    def _curves_run_along_numbers(self) -> "Study":
        if self.report == "curves" and not _are_numbers([*self.axes.values()][-1:]):
            raise ValueError("report curves needs numbers in the last of the study's axes, along which curves run")
        return self

    @model_validator(mode="after")
    def _what_the_report_needs_is_there(self) -> "Study":
        report, varied = REPORTS[self.report], {*self.axes, *(name for case in self.cases for name in case)}
        for names, known, where in (
            (report.varies, varied, "vary in cases or axes"),
            (report.sets, varied | set(self.set), "be in set, cases or axes"),
        ):
            if missing := [name for name in names if name not in known]:
                raise ValueError(f"report {self.report} needs {missing[0]} to {where}")
        for name in report.fixes:
            value = self.set.get(name)
            if name in varied or type(value) is not int:
                given = "in cases or axes" if name in varied else quote(value) if name in self.set else "missing"
                raise ValueError(f"report {self.report} needs {name} to be a whole number in set, and it is {given}")
        return self

    @model_validator(mode="after")
    def _figures_exist(self) -> "Study":
        known = REPORTS[self.report].targets
        for name in (*self.target, *self.paper):
            if name not in known:
                has = f"has {', '.join(known)}" if known else "has none"
                raise ValueError(
                    f"target and paper: {shorten(name)} is no figure of the report {self.report}, which {has}"
                )
        return self


@dataclass(frozen=True)
class Plan:
    """One run of a study.

    Attributes:
        scenario: The scenario to run.
        varied: Settings that distinguish the run from the study's other runs, by dotted name.
        run: Hash of everything the run depends on, which names its folder.
        recording: Hash of everything the recording depends on, which names its folder.
    """

    scenario: Scenario
    varied: Mapping[str, Any]
    run: str
    recording: str


def load_study(source: str, tiny: bool, full: bool = False) -> Study:
    """Read a study.

    Args:
        source: A name in assets/studies, or the path of a YAML file.
        tiny: Whether to use the small version that the study's ``tiny`` describes.
        full: Whether to use the long version that the study's ``full`` describes.

    Raises:
        InputError: The study is invalid; the message names every wrong field, its value and what is allowed.
    """
    if tiny and full:
        raise InputError("--tiny and --full exclude each other")
    path = find_settings("study", STUDIES, source)
    try:
        study = Study.model_validate({"name": clean_name(path.stem), **read_yaml(path)})
    except ValidationError as error:
        raise InputError(f"{shorten(str(path), 300)}: {describe_problems(error, Study)}") from None
    if full:
        study = _enlarge(study)
    if tiny:
        study = _shrink(study)
    return _seek_scenarios(study, path.parent)


def plan_runs(study: Study, progress: Report = ignore) -> list[Plan]:
    """Plan every run of a study, in order, and check each one.

    Args:
        study: The study.
        progress: Called with the number of runs planned and their total.

    Raises:
        InputError: There are too many runs, two are the same, two scenarios have one name, or some runs are invalid;
            the message describes the first problems and says how many more there are.
    """
    total = len(study.cases) * math.prod(map(len, study.axes.values())) * len(study.seeds)
    if total > MOST_RUNS:
        raise InputError(f"study {study.name} has {_write_count(total)} runs; a study has at most {MOST_RUNS}")
    points = list(_points(study))
    total = len(points)
    plan_one, plans, problems, wrong = _make_planner(study), [], {}, 0
    for done, (seed, varied) in enumerate(points):
        if done % STRIDE == 0:
            progress("plan", done, total)
        try:
            plans.append(plan_one(seed, varied))
        except InputError as error:
            problems[str(error)] = None
            wrong += 1
        if wrong >= MOST_WRONG:
            break
    if problems:
        stopped = f"; only the first {done + 1} of {total} runs were looked at" if wrong >= MOST_WRONG else ""
        text = join_problems(list(problems)[:MOST_PROBLEMS], len(problems))
        raise InputError(f"study {study.name}: {text}{stopped}")
    progress("plan", total, total)
    _refuse_twins(study, plans)
    _refuse_namesakes(study, plans)
    return plans


def describe(plan: Plan) -> str:
    """Describe in words what distinguishes a run."""
    return ", ".join([*(f"{name} {value}" for name, value in plan.varied.items()), f"seed {plan.scenario.seed}"])


def write_out(study: Study) -> str:
    """The resolved study as YAML."""
    return yaml.safe_dump(study.model_dump(mode="json", exclude={"tiny", "full"}), sort_keys=False)


def _are_numbers(axes: Sequence[Any]) -> bool:
    """Whether there is an axis, and all values of all axes are numbers."""
    values = [value for axis in axes for value in (axis if isinstance(axis, list | tuple) else [None])]
    return bool(values) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _shrink(study: Study) -> Study:
    small = _replace(study, study.tiny, "tiny")
    return small.model_copy(update={"target": {}, "paper": {}})  # targets say nothing about so small a study


def _enlarge(study: Study) -> Study:
    if study.full is None:
        raise InputError(f"study {study.name} has no long version: --full takes what a study's full describes")
    return _replace(study, study.full, "full")


def _replace(study: Study, other: Variation, kind: str) -> Study:
    given = {name: getattr(other, name) for name in other.model_fields_set}
    given |= {
        "set": {**study.set, **other.set},
        "name": f"{study.name[: LONGEST_NAME - 5]}-{kind}",
        "tiny": {},
        "full": None,
    }
    try:
        return Study.model_validate({**study.model_dump(), **given})
    except ValidationError as error:
        raise InputError(f"study {study.name}, {kind}: {describe_problems(error, Study)}") from None


def _seek_scenarios(study: Study, folder: Path) -> Study:
    """The same study, with the paths of the scenario files that are in the study's own folder."""

    def seek(source: str) -> str:
        beside = folder / source
        return str(beside) if beside.suffix in {".yaml", ".yml"} and isfile(beside) else source

    cases = [{**case, "scenario": seek(case["scenario"])} if "scenario" in case else case for case in study.cases]
    axes = {name: tuple(map(seek, values)) if name == "scenario" else values for name, values in study.axes.items()}
    return study.model_copy(update={"scenario": seek(study.scenario), "cases": tuple(cases), "axes": axes})


def _make_planner(study: Study) -> Callable[[int, Point], Plan]:
    """Make a function that plans one run and that reads each scenario and room only once for all runs."""
    room = lru_cache(maxsize=4)(read_room)  # few, since a room may take megabytes
    methods = {} if study.methods is None else {"methods": study.methods}

    @cache
    def read(source: str) -> tuple[Path, dict[str, Any]] | InputError:
        try:
            path = find_settings("scenario", SCENARIOS, source)
            return path, read_yaml(path, MOST_VALUES)
        except InputError as error:
            return error

    def plan(seed: int, varied: Point) -> Plan:
        settings = {name: value for name, value in varied.items() if name != "scenario"}
        found = read(varied.get("scenario", study.scenario))
        if isinstance(found, InputError):
            raise found
        path, values = found
        scenario = override_scenario(values, path, {**study.set, **flatten(settings), **methods, "seed": seed})
        _check_report_of(study.report, scenario)
        return Plan(scenario, varied, digest(scenario, room), digest_recording(scenario, room))

    return plan


def _check_report_of(name: str, scenario: Scenario) -> None:
    """Raise InputError if the report could not show a run of this scenario."""
    report = REPORTS[name]
    if wrong := [method for method in scenario.methods if report.networks and not find_method(method).in_steps]:
        raise InputError(f"methods {wrong[0]}: report {name} needs methods that train a network")
    if report.labels and not scenario.tag_camera.mounted:
        raise InputError(f"tag_camera.mounted False: report {name} needs labels from tags, so it must be True")


def _refuse_twins(study: Study, plans: Sequence[Plan]) -> None:
    seen: dict[str, Plan] = {}
    for plan in plans:
        if plan.run in seen:
            twins = f"{shorten(describe(plan), 200)} and {shorten(describe(seen[plan.run]), 200)}"
            raise InputError(f"study {study.name}: two runs are the same: {twins}")
        seen[plan.run] = plan


def _refuse_namesakes(study: Study, plans: Sequence[Plan]) -> None:
    """Raise InputError if two scenario files have one name: the table would take their runs for those of one."""
    named = dict.fromkeys((plan.scenario.name, plan.varied.get("scenario", study.scenario)) for plan in plans)
    first: dict[str, str] = {}
    for name, source in named:
        other = first.setdefault(name, source)
        if _find_file(source) != _find_file(other):
            both = f"{shorten(other, 200)} and {shorten(source, 200)}"
            raise InputError(
                f"study {study.name}: scenarios {both} have the same name, {name}; set name in one of them"
            )


def _find_file(source: str) -> Path:
    return find_settings("scenario", SCENARIOS, source).resolve()


def _write_count(count: int) -> str:
    return str(count) if count < 10**12 else "more than 10^12"


def _points(study: Study) -> Iterator[tuple[int, Point]]:
    points = (
        (seed, {**case, **dict(zip(study.axes, values, strict=True))})
        for case, values, seed in product(study.cases, product(*study.axes.values()), study.seeds)
    )
    draw = REPORTS[study.report].draw_runs
    yield from resolve_name(draw)(study.set, list(points)) if draw else points
