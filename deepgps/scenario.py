"""The scenario: everything that decides a run, from YAML and dotted overrides, frozen and checked at once."""

import difflib
import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal, cast

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from deepgps.settings import LearnSettings
from sim.errors import InputError
from sim.paths import SCENARIOS
from sim.records import SCHEMA
from sim.settings import NO_FAULTS, Group, SimSettings

MethodName = Literal[
    "deepgps",
    "deepgps_aware",
    "deepgps_turns",
    "posenet",
    "posenet_noisy",
    "odometry",
    "knn",
    "explicit",
    "explicit_mds",
    "pca_knn",
]
LARGEST_FILE = 1_000_000  # bytes; a scenario has a few hundred


class Scenario(SimSettings):
    """Everything that decides a run."""

    name: str = Field(default="unnamed", pattern=r"^[A-Za-z0-9_-]{1,64}$")
    """Name of the scenario; its runs lie under runs/<name>."""
    seed: int = Field(default=0, ge=0)
    """Driving, encoder, weights and shuffling each draw from a stream of this number."""
    methods: tuple[MethodName, ...] = ("deepgps", "posenet", "odometry", "knn")
    """Methods to train and compare."""
    learn: LearnSettings = LearnSettings()

    @field_validator("methods")
    @classmethod
    def _methods_differ(cls, methods: tuple[MethodName, ...]) -> tuple[MethodName, ...]:
        if not methods or len(set(methods)) != len(methods):
            raise ValueError("at least one method, each once")
        return methods

    @model_validator(mode="after")
    def _methods_suit_the_world(self) -> "Scenario":
        explicit = [name for name in self.methods if name.startswith("explicit")]
        if self.world != "landmarks" and explicit:
            raise ValueError(f"methods: {explicit[0]} needs distances to landmarks, which world landmarks alone gives")
        scans = self.world == "lidar" or (self.world == "room" and self.sensor == "lidar")
        if not scans and "pca_knn" in self.methods:
            raise ValueError("methods: pca_knn needs scans, which world lidar or, in a room, sensor lidar gives")
        if (scans or self.world == "landmarks") and self.learn.network.architecture != "spectral":
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
    def sim(self) -> SimSettings:
        """The part that decides the recording."""
        return SimSettings.model_validate({name: getattr(self, name) for name in SimSettings.model_fields})


def load_scenario(source: str, overrides: Mapping[str, Any]) -> Scenario:
    """Read a scenario and apply overrides.

    Args:
        source: A name in assets/scenarios, or the path of a YAML file.
        overrides: Values by dotted name, as ``{"room.seed": "3"}``.

    Raises:
        InputError: Names the field, the value and what is allowed.
    """
    path = find_settings("scenario", SCENARIOS, source)
    values = read_yaml(path)
    values.setdefault("name", path.stem)
    for dotted, value in overrides.items():
        _set(values, dotted, value)
    return check_scenario(values, path, overrides)


def find_settings(kind: str, folder: Path, source: str) -> Path:
    """Path of the settings file called ``source`` in a folder, or at that path.

    Raises:
        InputError: Names what does not exist, as a ``kind`` of thing, and what does.
    """
    path = Path(source)
    if path.suffix in {".yaml", ".yml"} or "/" in source:
        if not path.is_file():
            raise InputError(f"{kind} {source}: no such file")
        return path
    path = folder / f"{source}.yaml"
    if not path.is_file():
        raise InputError(f"{kind} {source!r} does not exist; there are {', '.join(names_in(folder))}, or a path")
    return path


def names_in(folder: Path) -> list[str]:
    """Names of the settings files in a folder."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping with nothing but plain values in it; raises InputError."""
    if path.stat().st_size > LARGEST_FILE:
        raise InputError(f"{path} has {path.stat().st_size} bytes; a settings file has at most {LARGEST_FILE}")
    try:
        values = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: {_first_problem(error)}") from None
    if values is None:
        raise InputError(f"{path} is empty; a settings file is a mapping, such as 'seed: 0'")
    if not isinstance(values, dict):
        raise InputError(f"{path} holds a {type(values).__name__}; a settings file is a mapping, such as 'seed: 0'")
    return values


def check_scenario(values: Mapping[str, Any], origin: Path, overrides: Collection[str] = ()) -> Scenario:
    """Make a scenario of plain values from a file and overrides on it.

    Raises:
        InputError: Names every wrong field in one line, and the file, where the fault lies there.
    """
    try:
        return Scenario.model_validate(values)
    except ValidationError as error:
        problems = error.errors()
        ours = all(".".join(map(str, problem["loc"])) in overrides for problem in problems)
        text = describe_problems(error, Scenario)
        raise InputError(text if ours else f"{origin}: {text}") from None


def describe_problems(error: ValidationError, kind: type[Group]) -> str:
    """Every wrong field of a group of this kind in one line: its name, its value and what is allowed."""
    return "; ".join(_describe(problem, kind) for problem in error.errors())


def write_out(scenario: Scenario) -> str:
    """The resolved scenario as YAML."""
    return yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False)


def digest(scenario: Scenario) -> str:
    """Eight hexadecimal digits of the resolved scenario, the schema and the room file, if one is used."""
    return _hash(_dump(scenario), scenario.room.mjcf)


def digest_recording(scenario: Scenario) -> str:
    """The same of the part that decides the recording."""
    return _hash(f"{scenario.seed} {_dump(scenario.sim)}", scenario.room.mjcf)


class _Loader(yaml.SafeLoader):
    """Plain values only, and no key twice: YAML would silently keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for index, key in enumerate(keys):
            if key in keys[:index]:
                mark = node.value[index][0].start_mark
                raise yaml.constructor.ConstructorError(None, None, f"{key} stands twice", mark)
        return super().construct_mapping(node, deep)


def _dump(settings: SimSettings) -> str:
    """Settings as they are hashed: without the groups that are off and once were not there, so that runs made then
    keep their names."""
    return settings.model_dump_json(exclude={name for name, off in NO_FAULTS.items() if getattr(settings, name) == off})


def _hash(settings: str, room: str | None) -> str:
    state = hashlib.sha256(f"{SCHEMA} {settings}".encode())
    if room is not None and Path(room).is_file():
        state.update(Path(room).read_bytes())
    return state.hexdigest()[:8]


def _set(values: dict[str, Any], dotted: str, value: Any) -> None:
    *groups, field = dotted.split(".")
    for group in groups:
        values = values.setdefault(group, {})
        if not isinstance(values, dict):
            raise InputError(f"{dotted}: {group} is not a group of settings")
    values[field] = value


def _describe(details: ErrorDetails, kind: type[Group]) -> str:
    name = ".".join(str(part) for part in details["loc"])
    if details["type"] == "extra_forbidden":
        return f"{name}: there is no such setting{_suggest(details['loc'], kind)}"
    if details["type"] == "value_error":
        message = details["msg"].removeprefix("Value error, ")
        return f"{name}: {message}" if name else message
    message = details["msg"][0].lower() + details["msg"][1:]
    return f"{name} {details['input']!r}: {message.replace('input should be', 'must be')}"


def _suggest(loc: tuple[int | str, ...], kind: type[Group]) -> str:
    group: Any = kind
    for part in loc[:-1]:
        group = group.model_fields[cast(str, part)].annotation
    names = list(group.model_fields)
    close = difflib.get_close_matches(str(loc[-1]), names, n=1)
    return f", did you mean {close[0]}?" if close else f"; there are {', '.join(names)}"


def _first_problem(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: {error.problem}"
    return str(error).splitlines()[0]
