"""What is wrong with settings, in one line: each field, its value and what is allowed."""

from collections.abc import Sequence
from itertools import zip_longest

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from deepgps.config.spelling import find_like, find_settings_like, find_type, list_groups, suggest
from sim.errors import quote, shorten
from sim.settings import Group

MAX_DEPTH = 8  # Limit of nested groups in the name of a setting
MAX_PROBLEMS = 5  # Number of wrong settings that one message describes; it only counts the others


def describe_problems(error: ValidationError, kind: type[Group]) -> str:
    """The first wrong fields of a group of this kind in one line, each with its value and what is allowed."""
    return describe_first(error.errors(include_url=False), kind)


def describe_first(problems: Sequence[ErrorDetails], kind: type[Group], names: Sequence[str | None] = ()) -> str:
    """The first problems; ``names`` are those of the settings, as the user has written them, where they are known."""
    known = zip_longest(problems[:MAX_PROBLEMS], names[:MAX_PROBLEMS])
    return join_problems([_describe(problem, kind, name) for problem, name in known], len(problems))


def join_problems(first: Sequence[str], count: int) -> str:
    """The first of ``count`` problems in one line, and the number of further ones."""
    return "; ".join([*first, *([f"and {count - len(first)} more"] if count > len(first) else [])])


def _describe(details: ErrorDetails, kind: type[Group], written: str | None = None) -> str:
    name = written or ".".join(shorten(str(part), 60) for part in details["loc"][:MAX_DEPTH])
    if details["type"] == "extra_forbidden":
        return f"{name}: {_explain_unknown(details['loc'], kind)}"
    if details["type"] == "value_error":
        message = shorten(details["msg"].removeprefix("Value error, "), 400)
        return f"{name}: {message}" if name else message
    message = details["msg"][0].lower() + details["msg"][1:]
    return f"{name} {quote(details['input'])}: {shorten(message.replace('input should be', 'must be'), 400)}"


def _explain_unknown(loc: tuple[int | str, ...], kind: type[Group]) -> str:
    """Why there is no setting at a place, and which the user may have meant."""
    dotted = ".".join(map(str, loc))
    if find_type(dotted, kind) is not None:
        return f"groups nest in a file: {': {'.join(dotted.split('.'))}: ...{'}' * dotted.count('.')}"
    return f"there is no such setting{_suggest(loc, kind)}"


def _suggest(loc: tuple[int | str, ...], kind: type[Group]) -> str:
    group = {"": kind, **dict(list_groups(kind))}.get(".".join(map(str, loc[:-1])))
    if group is None:
        return ""
    names = list(group.model_fields)
    like = find_like(str(loc[-1]), names)
    found = [like] if like else find_settings_like(".".join(map(str, loc)), kind)
    return suggest(found) or f"; there are {', '.join(names)}"
