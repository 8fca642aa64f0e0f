"""The runs of a study, all checked before the first one starts."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, lru_cache
from itertools import product
from pathlib import Path
from typing import Any

from deepgps.config.plain_yaml import read_yaml
from deepgps.config.scenario import find_settings, flatten, override_scenario
from deepgps.config.setting_problems import MAX_PROBLEMS, join_problems
from deepgps.runs.inputs import digest, digest_recording, read_room
from deepgps.studies.catalog import REPORTS
from deepgps.studies.study import Point, Study
from deepgps.studies.table import CASE, Plan
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError, shorten
from sim.files import SCENARIOS

MAX_RUNS = 10_000
STRIDE = 100  # Runs planned between two progress reports


def plan_runs(study: Study, progress: Report = ignore) -> list[Plan]:
    """Plan every run of a study, in order, and check each one.

    Raises InputError if there are too many runs, two are the same, two scenarios have one name, or some runs are
    invalid; the message describes the first problems and says how many more there are.
    """
    total = len(study.cases) * math.prod(map(len, study.axes.values())) * len(study.seeds)
    if total > MAX_RUNS:
        count = total if total < 10**12 else "more than 10^12"
        raise InputError(f"study {study.name} has {count} runs; a study has at most {MAX_RUNS}")
    points = list(_points(study))
    total = len(points)
    plan_one, plans, problems = _make_planner(study), [], {}
    for done, (seed, varied) in enumerate(points):
        if done % STRIDE == 0:
            progress("plan", done, total)
        try:
            plans.append(plan_one(seed, varied))
        except InputError as error:
            problems[str(error)] = None
    if problems:
        raise InputError(f"study {study.name}: {join_problems(list(problems)[:MAX_PROBLEMS], len(problems))}")
    progress("plan", total, total)
    _refuse_twins(study, plans)
    _refuse_namesakes(study, plans)
    return plans


def describe(plan: Plan) -> str:
    """Describe in words what distinguishes a run."""
    return ", ".join([*(f"{name} {value}" for name, value in plan.varied.items()), f"seed {plan.scenario.seed}"])


def _make_planner(study: Study) -> Callable[[int, Point], Plan]:
    """Make a function that plans one run and that reads each scenario and room only once for all runs."""
    room = lru_cache(maxsize=4)(read_room)  # few, since a room may take megabytes
    methods = {} if study.methods is None else {"methods": study.methods}

    @cache
    def read(source: str) -> tuple[Path, dict[str, Any]] | InputError:
        try:
            path = find_settings("scenario", SCENARIOS, source)
            return path, read_yaml(path)
        except InputError as error:
            return error

    def plan(seed: int, point: Point) -> Plan:
        varied = {name: value for name, value in point.items() if name != "methods"}
        settings = {name: value for name, value in point.items() if name not in {"scenario", CASE}}
        found = read(varied.get("scenario", study.scenario))
        if isinstance(found, InputError):
            raise found
        path, values = found
        scenario = override_scenario(values, path, {**study.set, **methods, **flatten(settings), "seed": seed})
        return Plan(scenario, varied, digest(scenario, room), digest_recording(scenario, room))

    return plan


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


def _points(study: Study) -> Iterator[tuple[int, Point]]:
    points = (
        (seed, {**case, **dict(zip(study.axes, values, strict=True))})
        for case, values, seed in product(study.cases, product(*study.axes.values()), study.seeds)
    )
    draw = REPORTS[study.report].draw_runs
    yield from draw(study.set, list(points)) if draw else points
