"""What the command does before it imports anything else, which takes a second: it is the first import of its file."""

import codecs
import os
import sys
import time
from multiprocessing import current_process
from pathlib import Path

from deepgps.command.signals import leave_at_signals
from deepgps.command.streams import open_streams

BEGUN = time.monotonic()
IS_WORKER = current_process().name != "MainProcess"  # known before parent_process() is
FILES = {"deepgps", "cli.py"}
"""How the command is started: as the script of the package, or as ``python -m deepgps.cli``."""


def use_utf8() -> None:
    """Start this process again in Python's UTF-8 mode where it cannot read the names of files as text."""
    if codecs.lookup(sys.getfilesystemencoding()).name == "ascii" and os.environ.get("PYTHONUTF8") != "1":
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


if Path(sys.argv[0]).name in FILES:  # not in a program that only imports a part of the command
    if not IS_WORKER:
        leave_at_signals()
        use_utf8()
    open_streams()
