"""Errors that are shown to the user as one line."""


class InputError(ValueError):
    """The input is wrong; the message names the field, the value and what is allowed. The command exits with 2."""


class DamagedError(InputError):
    """A finished file is truncated, missing, or differs from its checksum."""


class WorkError(RuntimeError):
    """The work failed for a reason outside the input (no renderer, a full disk). The command exits with 1."""


def one_line(error: BaseException | str) -> str:
    """The message of an error in one line, or its type if the message is empty."""
    return " ".join(str(error).split()) or type(error).__name__
