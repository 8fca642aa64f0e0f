"""The one line in which a command explains the exception that ends it, and its exit code."""

import errno
import os
import platform
import shutil
import signal
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from deepgps.terminal.signals import describe_signal
from sim.errors import InputError, WorkError, one_line
from sim.plugins import locate_failure

FULL_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, None)  # None: numpy says how many bytes were written, but not why
FAULT_PREFIX = "deepgps-fault-"  # Prefix of the names of files with a traceback


class Fault(Exception):
    """Wraps, as its cause, an unexpected exception that was raised while a command worked in ``folder``."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.folder = folder


@contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """Raise ``Fault`` for every exception but InputError and WorkError, so that its explanation can name the folder."""
    try:
        yield
    except (InputError, WorkError, Fault):
        raise
    except Exception as error:
        raise Fault(folder) from error


def explain(error: BaseException, words: Sequence[str], number: int | None = None) -> tuple[int, str, str]:
    """Explain the exception that ends a command, a consequence of the signal that was received, if any.

    Returns the exit code, the kind of the line, and its text.
    """
    folder = None
    if isinstance(error, Fault) and error.__cause__:
        folder, error = error.folder, error.__cause__
    if number or isinstance(error, KeyboardInterrupt):
        number = number or signal.SIGINT
        return 128 + number, "", describe_signal(number, words)
    if isinstance(error, InputError):
        return 2, "error", one_line(error)
    return 1, "failed", _describe(error, words, folder)


def write_fault(error: BaseException, words: Sequence[str], folder: Path | None) -> Path | None:
    """Write a new file with what is needed to find a fault, in the folder or else in the system's temporary folder;
    None: it could not be written anywhere."""
    trace = "".join(traceback.format_exception(error))
    machine = f"Python {platform.python_version()}, {platform.platform()}"
    text = f"deepgps {find_version()}, {machine}\n{list(words)}\n\n{trace}"
    for place in (folder, Path(tempfile.gettempdir())):
        with suppress(OSError):
            if place is not None and place.is_dir():
                # a new file under an unused name, so no link is followed
                handle, path = tempfile.mkstemp(".txt", FAULT_PREFIX, place)
                with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
                    file.write(text)
                return Path(path)
    return None


def _describe(error: BaseException, words: Sequence[str], folder: Path | None) -> str:
    if isinstance(error, WorkError):
        return one_line(error)
    if plugin := locate_failure(error):
        return f"{plugin}: {type(error).__name__}: {one_line(error)}"
    if isinstance(error, OSError):
        return _explain_file(error, folder)
    if isinstance(error, ModuleNotFoundError) and not (error.name or "sim").startswith(("sim", "deepgps")):
        return f"the package {error.name} is missing: deepgps doctor says how to install it"
    if isinstance(error, MemoryError):
        return f"the memory of this machine is not enough ({one_line(error)})"
    return _report(error, words, folder)


def _report(error: BaseException, words: Sequence[str], folder: Path | None) -> str:
    what = f"{type(error).__name__}: {one_line(error)[:300]}"
    path = write_fault(error, words, folder)
    where = f"please report it with the file {path}, which holds the traceback" if path else "its traceback is lost"
    if isinstance(error, RecursionError):
        return f"something in the input is nested too deeply ({what}); if it is not, {where}"
    if isinstance(error, UnicodeError):
        return f"a name or a file holds text that cannot be read or written ({what}); if none does, {where}"
    return f"{what}; this is a fault of deepgps {find_version()}, {where}"


def _explain_file(error: OSError, folder: Path | None) -> str:
    path = error.filename or folder
    text = one_line(error) if error.strerror is None else error.strerror
    if error.errno in FULL_DISK_ERRORS and folder is not None:
        with suppress(OSError):
            text += f" ({shutil.disk_usage(folder).free / 1e6:.1f} MB free)"
    return f"{os.fsdecode(path)}: {text}" if isinstance(path, str | bytes | Path) else text


def find_version() -> str:
    """The version of the installed package."""
    try:
        return version("deepgps")
    except PackageNotFoundError:
        return "of unknown version"
