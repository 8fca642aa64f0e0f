"""What a command prints: its results, its errors, and the warnings of all modules, one line each."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

LOGGERS = ("sim", "deepgps")
console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)
"""Also where the progress bars are, so that a line goes above them."""


def print_error(kind: str, text: Exception | str) -> None:
    """Print ``kind: text`` as one line on standard error, the kind in its colour; without a kind, the text alone."""
    colour = "yellow" if kind == "warning" else "red"
    head = f"[{colour}]{kind}:[/{colour}] " if kind else ""
    errors.print(head + _escape(text), soft_wrap=True)


class Warnings(logging.Handler):
    """Prints what the modules log, one line each."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        print_error(record.levelname.lower(), record.getMessage())


@contextmanager
def show_warnings() -> Iterator[None]:
    """Print warnings of ``sim`` and ``deepgps``, above the progress bars."""
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
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("warning: %(message)s"))
    handler.setLevel(logging.WARNING)
    for name in LOGGERS:
        logging.getLogger(name).addHandler(handler)


def _escape(text: Exception | str) -> str:
    """One line that rich takes as it is."""
    return " ".join(str(text).split()).replace("[", "\\[")
