"""Errors that reach the user as one line."""


class InputError(ValueError):
    """The input is wrong: names the field, the value and what is allowed. The command exits with 2."""


class DamagedError(InputError):
    """A file that was written whole is cut off, gone, or differs from its checksum."""


class WorkError(RuntimeError):
    """The work failed for a reason outside the input (no renderer, a full disk). The command exits with 1."""


def one_line(error: BaseException | str) -> str:
    """What an error says, in one line; its kind where it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__
