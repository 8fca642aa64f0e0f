"""The record of a command."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class NoArguments:
    pass


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        carry_out: Takes the words after the command's name.
        summary: What the command does, in a few words.
        arguments: Type of its arguments.
    """

    carry_out: Callable[[Sequence[str]], None]
    summary: str
    arguments: type = NoArguments
