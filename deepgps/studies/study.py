"""The study: one scenario and what varies in it."""

import re
from collections.abc import Mapping, Sequence
from os.path import isfile
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, Field, ValidationError, model_validator

from deepgps.config.learning import one_of
from deepgps.config.plain_yaml import read_yaml
from deepgps.config.scenario import MAX_NAME_LETTERS, NAME, MethodName, clean_name, find_settings, flatten
from deepgps.config.setting_problems import describe_problems
from deepgps.studies.catalog import REPORTS
from deepgps.studies.table import CASE
from sim.errors import InputError, quote, shorten
from sim.files import STUDIES
from sim.settings import Group
from sim.settings.group import Seed

ReportName = Annotated[str, one_of(REPORTS)]
Point = Annotated[dict[str, Any], AfterValidator(flatten)]


class Variation(Group):
    """What varies; in a study's ``tiny`` and ``full``, only the given fields replace the study's own."""

    methods: tuple[MethodName, ...] | None = None
    """Methods to train and compare; None: the scenario's own."""
    set: Point = Field(default_factory=dict)
    """Settings by dotted name, the same for all runs; a group given as a mapping sets those that it names."""
    cases: tuple[Point, ...] = Field(default=({},), min_length=1)
    """Explicit combinations of settings by dotted name; ``scenario`` names a scenario other than the study's own,
    ``methods`` other methods, and ``case`` gives the combination a name."""
    axes: dict[str, tuple[Any, ...]] = Field(default_factory=dict)
    """Values by dotted name; each case is run with every combination of these values."""
    seeds: tuple[Seed, ...] = Field(default=(0,), min_length=1)
    """Seeds of the scenario."""

    @model_validator(mode="after")
    def _each_name_varies_once(self) -> "Variation":
        varied = {name for case in self.cases for name in case}
        elsewhere = {*self.set, *self.axes}
        if wrong := [name for name in ("seed", "name") if name in elsewhere | varied]:
            raise ValueError(f"{wrong[0]} can be no name in set, cases or axes; a study has seeds and a name")
        if "methods" in elsewhere:
            raise ValueError("methods can be no name in set or axes; a study and its cases have methods")
        if both := [name for name in self.axes if name in varied]:
            raise ValueError(f"{shorten(both[0])} is both in cases and in axes")
        if empty := [name for name, values in self.axes.items() if not values]:
            raise ValueError(f"axes.{shorten(empty[0])} has no values")
        if wrong := [case[CASE] for case in self.cases if not isinstance(case.get(CASE, ""), str)]:
            raise ValueError(f"case {quote(wrong[0])} must be a name in words")
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
    networks: tuple[MethodName, ...] = ()
    """Methods that train a network, which --networks adds to the methods."""
    report: ReportName = "compare"
    """How the table is reported (deepgps/studies/catalog.py). compare: means over seeds, intervals,
    differences to the first case and a ranking, the default; curves: errors along the last axis, the default if that
    has numbers; rooms: means, and which method wins; plain: rows as they are."""
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
    def _what_the_report_needs_varies(self) -> "Study":
        varied = {*self.axes, *(name for case in self.cases for name in case)}
        if missing := [name for name in REPORTS[self.report].varies if name not in varied]:
            raise ValueError(f"report {self.report} needs {missing[0]} to vary in cases or axes")
        return self

    @model_validator(mode="after")
    def _figures_exist(self) -> "Study":
        known = [target.name for target in REPORTS[self.report].targets]
        for name in (*self.target, *self.paper):
            if not any(re.fullmatch(re.sub(r"\{\w+\}", r"\\w*", one), name) for one in known):
                has = f"has {', '.join(known)}" if known else "has none"
                raise ValueError(
                    f"target and paper: {shorten(name)} is no figure of the report {self.report}, which {has}"
                )
        return self


def load_study(source: str, tiny: bool, full: bool = False, networks: bool = False) -> Study:
    """Read a study, in assets/studies or at a path, as it is or in the small or long version that its file describes.

    With ``networks``, it also trains those of its file. Raises InputError; the message names every wrong field, its
    value and what is allowed.
    """
    if tiny and full:
        raise InputError("--tiny and --full exclude each other")
    path = find_settings("study", STUDIES, source)
    try:
        study = Study.model_validate({"name": clean_name(path.stem), **read_yaml(path)})
    except ValidationError as error:
        raise InputError(f"{shorten(str(path), 300)}: {describe_problems(error, Study)}") from None
    if full and study.full is None:
        raise InputError(f"study {study.name} has no long version: --full takes what a study's full describes")
    if networks and not study.networks:
        raise InputError(f"study {study.name} has no further methods: --networks takes what a study's networks lists")
    if full and study.full:
        study = _replace(study, study.full, "full")
    if tiny:  # targets say nothing about so small a study
        study = _replace(study, study.tiny, "tiny").model_copy(update={"target": {}, "paper": {}})
    if networks:
        study = study.model_copy(update={"methods": (*(study.methods or ()), *study.networks)})
    return _seek_scenarios(study, path.parent)


def write_out(study: Study) -> str:
    """The resolved study as YAML."""
    return yaml.safe_dump(study.model_dump(mode="json", exclude={"tiny", "full", "networks"}), sort_keys=False)


def _are_numbers(axes: Sequence[Any]) -> bool:
    values = [value for axis in axes for value in (axis if isinstance(axis, list | tuple) else [None])]
    return bool(values) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _replace(study: Study, other: Variation, kind: str) -> Study:
    given = {name: getattr(other, name) for name in other.model_fields_set}
    given |= {
        "set": {**study.set, **other.set},
        "name": f"{study.name[: MAX_NAME_LETTERS - 5]}-{kind}",
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
