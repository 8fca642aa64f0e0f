"""The scenario: every setting that determines a run, from YAML and dotted overrides, frozen and checked at once."""

import hashlib
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import zip_longest
from os.path import exists, isfile
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from deepgps.methods.catalog import METHODS
from deepgps.plain_yaml import read_yaml
from deepgps.settings import LearnSettings, check_name
from deepgps.spelling import as_key, find_group, find_like, find_settings_like, suggest
from sim.errors import InputError
from sim.files.checksums import sha256
from sim.paths import SCENARIOS
from sim.plugins import HOW_TO_LOAD
from sim.recording.manifest import SCHEMA, ObservationKind, name_sensors
from sim.renamed import explain_setting, explain_value
from sim.settings import Group, SimSettings
from sim.settings.group import WithPlugins
from sim.user_input import quote, read_file, shorten


def _check_method(name: str, info: ValidationInfo) -> str:
    """A run with a plugin's method can be opened without the plugin, though not continued."""
    return name if name in info.data.get("plugins", {}) else check_name(name, METHODS, f"; {HOW_TO_LOAD}")


MethodName = Annotated[str, AfterValidator(_check_method)]
GIVEN_BY: dict[ObservationKind, str] = {
    "polar_image": "images, which world room with sensor fisheye gives",
    "scan": "scans, which world obstacles or, in a room, sensor lidar gives",
    "vector": "distances to landmarks, which world landmarks alone gives",
}
MOST_VALUES = 1000
"""Limit of keys and values in a scenario's file; all existing settings together make 250."""
LONGEST_NAME = 64
NAME = rf"^[A-Za-z0-9_-]{{1,{LONGEST_NAME}}}$"
"""Pattern of the names of scenarios and studies, which name folders."""
DEEPEST = 8
"""Limit of nested groups in the name of a setting."""
MOST_PROBLEMS = 5
"""Number of wrong settings that one message describes; it only counts the others."""


class PluginSource(Group):
    """The source of a plugin."""

    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Scenario(WithPlugins, SimSettings):
    """Every setting that determines a run."""

    name: str = Field(default="unnamed", pattern=NAME)
    """Name of the scenario; its runs are stored under runs/<name>. In a file without it, the file's own name, with _
    for other letters than a name may hold."""
    seed: int = Field(default=0, ge=0)
    """Seed of everything random; each part of the work draws from an RNG stream of its own."""
    plugins: dict[str, PluginSource] = Field(default_factory=dict)
    """The plugins of those methods that deepgps does not have itself; filled in from the plugins that are loaded."""
    methods: tuple[MethodName, ...] = ("deepgps", "posenet", "dead_reckoned_labels", "knn")
    """Methods to train and compare."""
    learn: LearnSettings = LearnSettings()

    @model_validator(mode="before")
    @classmethod
    def _add_the_sources(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or not isinstance(values.get("methods"), list | tuple):
            return values
        given = values.get("plugins", {})
        if not isinstance(given, Mapping):
            return values  # which the field's own check refuses
        names = [name for name in values["methods"] if isinstance(name, str)]
        loaded = {name: METHODS[name].source for name in names if name in METHODS}
        sources = {name: {"sha256": source.sha256} for name, source in loaded.items() if source}
        return {**values, "plugins": {**sources, **{name: given[name] for name in names if name in given}}}

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
                raise ValueError(f"methods: {name} needs {GIVEN_BY[observes]}")
            if name in METHODS and METHODS[name].reads_turns and not self.drive.turn_images:
                raise ValueError(f"methods: {name} needs drive.turn_images true")
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


Spell = Callable[[str], str]
"""Writes the dotted name of a setting as the user has written it."""


def load_scenario(source: str, overrides: Mapping[str, Any], spell: Spell = as_key) -> Scenario:
    """Read a scenario and apply overrides.

    Args:
        source: A name in assets/scenarios, or the path of a YAML file.
        overrides: Values by dotted name, such as ``{"room.seed": "3"}``.
        spell: How messages write the names of overrides.

    Raises:
        InputError: A setting is wrong; the message names the field, the value and what is allowed.
    """
    path = find_settings("scenario", SCENARIOS, source)
    return override_scenario(read_yaml(path, MOST_VALUES), path, overrides, spell)


def override_scenario(
    values: Mapping[str, Any], path: Path, overrides: Mapping[str, Any], spell: Spell = as_key
) -> Scenario:
    """Make a scenario from the plain values of a file, which are not modified, and overrides.

    Raises:
        InputError: A setting is wrong; the message names the field, the value and what is allowed.
    """
    values, overrides = {"name": clean_name(path.stem), **values}, flatten(overrides)
    for dotted, value in overrides.items():
        values = _set(values, dotted, dotted.split("."), value)
    return check_scenario(values, path, overrides, spell)


def clean_name(text: str) -> str:
    """A name after that of a file or folder: without what no name of a scenario, study or recording may hold."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", text)[:LONGEST_NAME]


def flatten(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides by the dotted names of single settings: a group given as a mapping sets what it names, and no more.

    Args:
        overrides: Values by dotted name, such as ``{"drive": {"samples": 300}, "room.seed": 3}``.

    Raises:
        InputError: A setting is given twice, as by ``drive.samples`` and in ``drive``.
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

    Raises:
        InputError: There is no such file; the message names it as a ``kind`` of thing, and those that exist.
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


def check_scenario(
    values: Mapping[str, Any], origin: Path, overrides: Collection[str] = (), spell: Spell = as_key
) -> Scenario:
    """Make a scenario from plain values, those of a file with overrides applied.

    Raises:
        InputError: Settings are wrong; one line names them, and the file unless all of them are overrides.
    """
    try:
        return Scenario.model_validate(values)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        names = [_find_override(problem, overrides) for problem in problems]
        ours = all(name is not None for name in names)
        text = _describe_all(problems, Scenario, [spell(name) if name else None for name in names])
        raise InputError(text if ours else f"{shorten(str(origin), 300)}: {text}") from None


def describe_problems(error: ValidationError, kind: type[Group]) -> str:
    """The first wrong fields of a group of this kind in one line, each with its value and what is allowed."""
    return _describe_all(error.errors(include_url=False), kind)


def _describe_all(problems: Sequence[ErrorDetails], kind: type[Group], names: Sequence[str | None] = ()) -> str:
    """The first problems; ``names`` are those of the settings, as the user has written them, where they are known."""
    known = zip_longest(problems[:MOST_PROBLEMS], names[:MOST_PROBLEMS])
    return join_problems([_describe(problem, kind, name) for problem, name in known], len(problems))


def _find_override(problem: ErrorDetails, overrides: Collection[str]) -> str | None:
    """The override that a problem is about, or in whose list it is."""
    dotted = ".".join(map(str, problem["loc"]))
    return next((name for name in overrides if dotted == name or dotted.startswith(f"{name}.")), None)


def join_problems(first: Sequence[str], count: int) -> str:
    """The first of ``count`` problems in one line, and the number of further ones."""
    return "; ".join([*first, *([f"and {count - len(first)} more"] if count > len(first) else [])])


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


def list_own_files(scenario: Scenario) -> dict[str, str]:
    """The files of an own room and an own robot by the setting that names them."""
    files = {"room.mjcf": scenario.room.mjcf, "robot.mjcf": scenario.robot.mjcf}
    return {field: path for field, path in files.items() if path}


def read_room(path: str, field: str = "room.mjcf") -> bytes | None:
    """What tells a room or a robot from others: the bytes of its file, and the checksums of all files that it uses.

    Args:
        path: Its file.
        field: The setting that names it, for messages.

    Returns:
        None if there is no file.

    Raises:
        InputError: A file cannot be read, or is none that a room can use.
    """
    if not isfile(Path(path)):
        return None
    from sim.rooms.mjcf_files import LARGEST_MJCF, Files

    used = Files(Path(path), field).list_used()
    return read_file(Path(path), LARGEST_MJCF, shorten(path, 300)) + b"".join(
        bytes.fromhex(sha256(one)) for one in used
    )


def digest(scenario: Scenario, read: Callable[[str, str], bytes | None] = read_room) -> str:
    """Eight hexadecimal digits of the resolved scenario, the schema and the files of an own room or robot.

    Args:
        scenario: The scenario.
        read: What ``read_room`` returns; a caller that hashes many scenarios of one room can cache it.
    """
    return _hash(scenario.model_dump_json(), scenario, read)


def digest_recording(scenario: Scenario, read: Callable[[str, str], bytes | None] = read_room) -> str:
    """The same digest of the settings that determine the recording."""
    return _hash(f"{scenario.seed} {scenario.sim.model_dump_json()}", scenario, read)


def _hash(settings: str, scenario: Scenario, read: Callable[[str, str], bytes | None]) -> str:
    state = hashlib.sha256(f"{SCHEMA} {settings}".encode())
    for field, path in list_own_files(scenario).items():
        state.update(read(path, field) or b"")
    return state.hexdigest()[:8]


def _set(values: Mapping[str, Any], dotted: str, names: Sequence[str], value: Any) -> dict[str, Any]:
    """A copy of nested groups in which the field with the path ``names`` is set."""
    name, *inner = names
    if not inner:
        nothing = isinstance(value, Mapping) and isinstance(values.get(name), Mapping)  # it is empty after flatten
        return dict(values) if nothing else {**values, name: value}
    group = values.get(name, {})
    if not isinstance(group, Mapping):
        raise InputError(f"{shorten(dotted)}: {shorten(name)} is not a group of settings")
    if len(inner) > DEEPEST:
        raise InputError(f"{shorten(dotted)}: there is no such setting")
    return {**values, name: _set(group, dotted, inner, value)}


def _describe(details: ErrorDetails, kind: type[Group], written: str | None = None) -> str:
    name = written or ".".join(shorten(str(part), 60) for part in details["loc"][:DEEPEST])
    dotted = ".".join(map(str, details["loc"]))
    if details["type"] == "extra_forbidden" and (renamed := explain_setting(dotted)):
        return f"{name}: {renamed}"
    if details["type"] == "literal_error" and (renamed := explain_value(dotted, details["input"])):
        return f"{name} {quote(details['input'])}: {renamed}"
    if details["type"] == "extra_forbidden":
        return f"{name}: there is no such setting{_suggest(details['loc'], kind)}"
    if details["type"] == "value_error":
        message = shorten(details["msg"].removeprefix("Value error, "), 400)
        return f"{name}: {message}" if name else message
    message = details["msg"][0].lower() + details["msg"][1:]
    return f"{name} {quote(details['input'])}: {shorten(message.replace('input should be', 'must be'), 400)}"


def _suggest(loc: tuple[int | str, ...], kind: type[Group]) -> str:
    group: type[Group] | None = kind
    for part in loc[:-1]:
        group = find_group(group.model_fields[str(part)].annotation) if group else None
    if group is None:
        return ""
    names = list(group.model_fields)
    like = find_like(str(loc[-1]), names)
    found = [like] if like else find_settings_like(".".join(map(str, loc)), kind)
    return suggest(found) or f"; there are {', '.join(names)}"
