"""Errors that are shown to the user as one line, and input from users: read only from regular files, quoted briefly."""

import os
import reprlib
import stat
from pathlib import Path
from typing import Any


class InputError(ValueError):
    """The input is wrong; the message names the field, the value and what is allowed. The command exits with 2."""


class DamagedError(InputError):
    """A finished file is truncated, missing, or differs from its checksum."""


class WorkError(RuntimeError):
    """The work failed for a reason outside the input (no renderer, a full disk). The command exits with 1."""


def one_line(error: BaseException | str) -> str:
    """The message of an error in one line, or its type if the message is empty."""
    return " ".join(str(error).split()) or type(error).__name__


_SHORT_REPR = reprlib.Repr()
_SHORT_REPR.maxlevel, _SHORT_REPR.maxdict, _SHORT_REPR.maxstring, _SHORT_REPR.maxother = 3, 6, 80, 80


def quote(value: Any, most: int = 80) -> str:
    """The ``repr`` of a value of any size, in at most ``most`` characters."""
    try:
        return shorten(_SHORT_REPR.repr(value), most)
    except ValueError:  # Python refuses to format an integer of many thousand digits
        return f"a very long {type(value).__name__}"


def shorten(text: str, most: int = 80) -> str:
    """A text in one line of at most ``most`` printable characters; the middle of a longer text is left out."""
    half = (most - 3) // 2
    shown = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
    return shown if len(shown) <= most else f"{shown[:half]}...{shown[-half:]}"


def read_file(path: Path, largest: int, what: str) -> bytes:
    """Read a regular file without waiting for a pipe or reading a device; messages name it ``what``.

    Raises InputError if the path is missing, a folder, a pipe or a device, or the file is too large [bytes] or
    unreadable.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # otherwise opening a pipe blocks
    except FileNotFoundError:
        raise InputError(f"{what}: no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{what} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        state = os.fstat(handle)
        if not stat.S_ISREG(state.st_mode):
            kind = "a folder" if stat.S_ISDIR(state.st_mode) else "a pipe or a device"
            raise InputError(f"{what} is {kind}, not a file")
        if state.st_size > largest:
            raise InputError(f"{what} has {state.st_size} bytes; at most {largest} are read")
        with open(handle, "rb", closefd=False) as file:
            return file.read(largest)
    except OSError as error:
        raise InputError(f"{what} cannot be read: {error.strerror}") from None
    finally:
        os.close(handle)
