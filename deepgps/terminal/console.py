"""What a command prints: its results, its errors, and the warnings of all modules, one line each."""

import logging
import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.text import Text

LOGGERS = ("sim", "deepgps")
WIDTH = 80 if os.environ.get("COLUMNS") == "0" else None  # without a terminal in a container, no table would fit
console = Console(highlight=False, width=WIDTH)
errors = Console(stderr=True, highlight=False, width=WIDTH)
"""Shared with the progress bars, so that a line is printed above them."""


def say(text: str) -> None:
    """Print text as it is: brackets are no markup, and no line is broken."""
    console.print(text, markup=False, soft_wrap=True)


def quote_path(path: Path) -> str:
    """A path as a word of a command that can be copied into a shell."""
    return shlex.quote(str(path))


def print_error(kind: str, text: Exception | str) -> None:
    """Print ``kind: text`` as one line on standard error, the kind in its colour; without a kind, the text alone."""
    head = [(f"{kind}:", "yellow" if kind == "warning" else "red"), " "] if kind else []
    errors.print(Text.assemble(*head, " ".join(str(text).split())), soft_wrap=True)


class Warnings(logging.Handler):
    """Prints the log records of all modules, one line each."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        print_error(record.levelname.lower(), record.getMessage())


@contextmanager
def show_warnings() -> Iterator[None]:
    """Print warnings of ``sim`` and ``deepgps``, above the progress bars."""
    _silence_caches()
    handler = Warnings(logging.WARNING)
    loggers = [logging.getLogger(name) for name in LOGGERS]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


def warn_plainly() -> None:
    """Print warnings as plain lines, from a worker process."""
    _silence_caches()
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("warning: %(message)s"))
    handler.setLevel(logging.WARNING)
    for name in LOGGERS:
        logging.getLogger(name).addHandler(handler)


def _silence_caches() -> None:
    """Silence complaints about a home folder that is missing or not writable: only caches are lost, no result."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    if not os.path.isdir(os.environ.get("XDG_CACHE_HOME") or os.sep):
        os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")
