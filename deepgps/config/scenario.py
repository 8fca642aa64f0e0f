"""The scenario: every setting that determines a run, from YAML and dotted overrides, frozen and checked at once."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from os.path import exists, isfile
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, BaseModel, Field, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic_core import ErrorDetails

from deepgps.config.learning import LearnSettings, check_name
from deepgps.config.methods import METHODS
from deepgps.config.plain_yaml import read_yaml
from deepgps.config.setting_problems import MAX_DEPTH, describe_first, describe_problems
from deepgps.config.spelling import find_like, suggest
from sim.errors import InputError, quote, shorten
from sim.files import SCENARIOS
from sim.plugins import ENCODER_FAULTS, LOADING_HINT
from sim.recording.manifest import ObservationKind, name_sensors
from sim.settings import SimSettings
from sim.settings.group import Seed

STORED_CONTEXT = "stored"
"""The context in which a stored run's scenario is checked: it can be opened without its plugins, not continued."""


def _check_method(name: str, info: ValidationInfo) -> str:
    return name if info.context == STORED_CONTEXT else check_name(name, METHODS, f"; {LOADING_HINT}")


MethodName = Annotated[str, AfterValidator(_check_method)]
OBSERVATION_SOURCES: dict[ObservationKind, str] = {
    "polar_image": "images, which world room with sensor fisheye gives",
    "scan": "scans, which world obstacles or, in a room, sensor lidar gives",
    "vector": "distances to landmarks, which world landmarks alone gives",
}
MAX_NAME_LETTERS = 64
NAME = rf"^[A-Za-z0-9_-]{{1,{MAX_NAME_LETTERS}}}$"  # Pattern of the names of scenarios and studies, which name folders


class Scenario(SimSettings):
    """Every setting that determines a run."""

    name: str = Field(default="unnamed", pattern=NAME)
    """Name of the scenario; its runs are stored under runs/<name>. In a file without it, the file's own name, with _
    for other letters than a name may hold."""
    seed: Seed = 0
    """Seed of everything random; each part of the work draws from an RNG stream of its own."""
    methods: tuple[MethodName, ...] = ("deepgps", "posenet", "dead_reckoned_labels", "knn")
    """Methods to train and compare."""
    learn: LearnSettings = LearnSettings()

    @model_validator(mode="after")
    def _plugins_define_the_faults(self, info: ValidationInfo) -> "Scenario":
        for name, strength in self.encoder.plugins.items():
            if name not in ENCODER_FAULTS and info.context != STORED_CONTEXT:
                raise ValueError(f"encoder.plugins.{shorten(name)} {strength:g}: no such fault; {LOADING_HINT}")
        return self

    @field_validator("methods")
    @classmethod
    def _methods_differ(cls, methods: tuple[MethodName, ...]) -> tuple[MethodName, ...]:
        if not methods or len(set(methods)) != len(methods):
            raise ValueError("at least one method, each once")
        return methods

    @model_validator(mode="after")
    def _methods_suit_the_world(self) -> "Scenario":
        for name in self.methods:
            observes = METHODS[name].observes if name in METHODS else None
            if observes and observes != self.observation:
                raise ValueError(f"methods: {name} needs {OBSERVATION_SOURCES[observes]}")
            if name in METHODS and METHODS[name].map == "compass" and not self.drive.turn_images:
                raise ValueError(f"methods: {name} needs drive.turn_images true")
        if (radius_m := self.drive.until.radius_m) is not None and "registration" not in self.methods:
            raise ValueError(f"drive.until.radius_m {radius_m:g} needs registration in methods")
        if self.observation != "polar_image" and self.learn.network.architecture != "spectral":
            by = "sensor lidar" if self.world == "room" else f"world {self.world}"
            raise ValueError(
                f"learn.network.architecture {self.learn.network.architecture!r} needs images, which {by} "
                "does not give; spectral takes distances"
            )
        return self

    @model_validator(mode="after")
    def _the_circle_can_be_halved(self) -> "Scenario":
        if self.learn.network.architecture == "invariant" and self.camera.sectors % 32 != 0:
            raise ValueError(
                "learn.network.architecture 'invariant' halves the circle five times, so camera.sectors must be a "
                f"multiple of 32, and is {self.camera.sectors}"
            )
        return self

    @property
    def observation(self) -> ObservationKind:
        """The kind of observation that methods learn from."""
        return next(iter(name_sensors(self).values()))

    @property
    def title(self) -> str:
        """The name that reports give a run, that of the scenario or of the file of the user's own room."""
        return self.name if self.room.mjcf is None else Path(self.room.mjcf).name

    @property
    def sim(self) -> SimSettings:
        """The part that determines the recording."""
        return SimSettings.model_validate({name: getattr(self, name) for name in SimSettings.model_fields})


Spell = Callable[[str], str]  # Writes the dotted name of a setting as the user has written it


def load_scenario(source: str, overrides: Mapping[str, Any], spell: Spell = str) -> Scenario:
    """Read a scenario, in assets/scenarios or at a path, and apply overrides by dotted name: ``{"room.seed": "3"}``.

    ``spell`` is how messages write their names. Raises InputError, which names the field, the value and what may be.
    """
    path = find_settings("scenario", SCENARIOS, source)
    return override_scenario(read_yaml(path), path, overrides, spell)


def override_scenario(
    values: Mapping[str, Any], path: Path, overrides: Mapping[str, Any], spell: Spell = str
) -> Scenario:
    """Make a scenario from the plain values of a file, which are not modified, and overrides.

    Raises InputError if settings are wrong; one line names them, their values and what is allowed, and the file unless
    the overrides alone are wrong.
    """
    given, overrides = {"name": clean_name(path.stem), **values}, flatten(overrides)
    values = given
    for dotted, value in overrides.items():
        values = _set(values, dotted, dotted.split("."), value)
    try:
        return Scenario.model_validate(values)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        names = [_find_override(problem, overrides) for problem in problems]
        text = describe_first(problems, Scenario, [spell(name) if name else None for name in names])
        ours = all(name is not None for name in names) or (overrides and _is_valid(given))
        raise InputError(text if ours else f"{shorten(str(path), 300)}: {text}") from None


def clean_name(text: str) -> str:
    """A name after that of a file or folder: without what no name of a scenario, study or recording may hold."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", text)[:MAX_NAME_LETTERS]


def flatten(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides by the dotted names of single settings: a group given as a mapping sets what it names, and no more.

    They are such as ``{"drive": {"samples": 300}, "room.seed": 3}``. Raises InputError if a setting is given twice, as
    by ``drive.samples`` and in ``drive``.
    """
    flat: dict[str, Any] = {}
    for name, value in _list_leaves(overrides):
        if name in flat:
            raise InputError(f"{shorten(name)}: given twice, as {quote(flat[name])} and {quote(value)}; give it once")
        flat[name] = value
    return flat


def _list_leaves(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _list_leaves(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def find_settings(kind: str, folder: Path, source: str) -> Path:
    """Path of the settings file called ``source`` in a folder, or at that path.

    Raises InputError if there is none; the message names it as a ``kind`` of thing, and those that exist.
    """
    path = Path(source)
    if path.suffix in {".yaml", ".yml"} or "/" in source:
        if not isfile(path):
            raise InputError(f"{kind} {shorten(source, 300)}: {'it is no file' if exists(path) else 'no such file'}")
        return path
    path = folder / f"{source}.yaml"
    if not isfile(path):
        names = names_in(folder)
        hint = suggest([find_like(source, names)]) or f"; there are {', '.join(names)}, or a path"
        raise InputError(f"{kind} {quote(source)} does not exist{hint}")
    return path


def names_in(folder: Path) -> list[str]:
    """Names of the settings files in a folder."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def check_scenario(values: Mapping[str, Any], origin: Path) -> Scenario:
    """Make a scenario from the values of a stored run's file; raises InputError that names it, and the settings."""
    try:
        return Scenario.model_validate(values, context=STORED_CONTEXT)
    except ValidationError as error:
        raise InputError(f"{shorten(str(origin), 300)}: {describe_problems(error, Scenario)}") from None


def _is_valid(values: Mapping[str, Any]) -> bool:
    try:
        Scenario.model_validate(values)
    except ValidationError:
        return False
    return True


def _find_override(problem: ErrorDetails, overrides: Collection[str]) -> str | None:
    """The override that a problem is about, or in whose list it is."""
    dotted = ".".join(map(str, problem["loc"]))
    return next((name for name in overrides if dotted == name or dotted.startswith(f"{name}.")), None)


def write_out(scenario: Scenario) -> str:
    """The resolved scenario as YAML."""
    return yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False)


def list_settings(group: BaseModel, before: str = "") -> dict[str, Any]:
    """All settings of a scenario, or of a group of it, by dotted name, with those that are at their defaults."""
    found: dict[str, Any] = {}
    for name in type(group).model_fields:
        value = getattr(group, name)
        if isinstance(value, BaseModel):
            found |= list_settings(value, f"{before}{name}.")
        elif isinstance(value, Mapping):  # plugins by name
            found |= {f"{before}{name}.{key}": one for key, one in value.items()}
        else:
            found[before + name] = list(value) if isinstance(value, tuple) else value
    return found


def _set(values: Mapping[str, Any], dotted: str, names: Sequence[str], value: Any) -> dict[str, Any]:
    """A copy of nested groups in which the field with the path ``names`` is set."""
    name, *inner = names
    if not inner:
        nothing = isinstance(value, Mapping) and isinstance(values.get(name), Mapping)  # it is empty after flatten
        return dict(values) if nothing else {**values, name: value}
    group = values.get(name, {})
    if not isinstance(group, Mapping):
        raise InputError(f"{shorten(dotted)}: {shorten(name)} is not a group of settings")
    if len(inner) > MAX_DEPTH:
        raise InputError(f"{shorten(dotted)}: there is no such setting")
    return {**values, name: _set(group, dotted, inner, value)}
