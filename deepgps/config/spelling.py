"""Names of settings, spelled as YAML keys or as options of the command line, and what a wrong one may have meant."""

import difflib
from collections.abc import Collection, Iterator
from typing import Any, get_args, get_origin

from sim.settings import Group

MIN_SIMILARITY, MIN_SIMILARITY_OF_MANY = 0.65, 0.8  # Of a misspelling: among few names, and among many
MAX_LETTERS = 100  # Letters of a name that are compared


def as_option(dotted: str) -> str:
    """A setting as on the command line: ``--encoder.step-noise``."""
    return f"--{dotted.replace('_', '-')}"


def from_option(option: str) -> str:
    """The dotted name of an option, which may also be spelled with underscores."""
    return option.removeprefix("--").replace("-", "_")


def find_group(annotation: Any) -> type[Group] | None:
    """The group of settings that a field holds, if it does; an optional group is a member of a union."""
    parts = (annotation, *get_args(annotation)) if get_origin(annotation) is not dict else ()
    return next((part for part in parts if isinstance(part, type) and issubclass(part, Group)), None)


def list_groups(kind: type[Group], before: str = "") -> Iterator[tuple[str, type[Group]]]:
    """Dotted names of the groups inside a group of settings, each with its type."""
    for name, field in kind.model_fields.items():
        if inner := find_group(field.annotation):
            yield before + name, inner
            yield from list_groups(inner, f"{before}{name}.")


def list_settings(kind: type[Group], before: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names of all settings of a group and of those inside it, each with its type."""
    for name, field in kind.model_fields.items():
        if inner := find_group(field.annotation):
            yield from list_settings(inner, f"{before}{name}.")
        else:
            yield f"{before}{name}", field.annotation


def find_type(dotted: str, kind: type[Group]) -> Any:
    """The type of a setting, or of a table in which the dotted name is an entry; None: there is no such setting."""
    settings = dict(list_settings(kind))
    table, _, _ = dotted.rpartition(".")
    return settings.get(dotted) or (settings.get(table) if get_origin(settings.get(table)) is dict else None)


def find_like(name: str, known: Collection[str]) -> str | None:
    """The one of a few names that is most like a wrong one, if any is."""
    return next(iter(difflib.get_close_matches(name[:MAX_LETTERS], known, n=1, cutoff=MIN_SIMILARITY)), None)


def find_settings_like(dotted: str, kind: type[Group]) -> list[str]:
    """Settings that a wrong dotted name may have meant: the same name in other groups, or one of the same group."""
    names = [name for name, _ in list_settings(kind)]
    group, _, leaf = dotted[:MAX_LETTERS].rpartition(".")
    inside = {name.rpartition(".")[2]: name for name in names if name.rpartition(".")[0] == group}
    if elsewhere := [name for name in names if name.rpartition(".")[2] == leaf]:
        return elsewhere[:3]
    if like := find_like(leaf, inside):
        return [inside[like]]
    if group:
        return difflib.get_close_matches(dotted[:MAX_LETTERS], names, n=1, cutoff=MIN_SIMILARITY_OF_MANY)
    leaves = {name.rpartition(".")[2]: name for name in names}
    return [leaves[like] for like in difflib.get_close_matches(leaf, leaves, n=1, cutoff=MIN_SIMILARITY_OF_MANY)]


def suggest(found: Collection[str | None]) -> str:
    """The end of a message about a wrong name: a question, or nothing."""
    some = [name for name in found if name]
    return f", did you mean {' or '.join(some)}?" if some else ""
