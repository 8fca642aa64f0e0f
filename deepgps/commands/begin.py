"""What the command does before its other imports, which take a second: this is the first import of its file."""

import sys
import time
from multiprocessing import current_process
from pathlib import Path

from deepgps.terminal.signals import leave_at_signals
from deepgps.terminal.streams import open_streams

START_S = time.monotonic()
WORKER_PROCESS = current_process().name != "MainProcess"  # known before parent_process() is
PROGRAM_NAMES = {"deepgps", "main.py"}
"""File names under which the command is started: the package's script, or ``python -m deepgps.commands.main``."""


if Path(sys.argv[0]).name in PROGRAM_NAMES:  # not in a program that only imports part of the command
    if not WORKER_PROCESS:
        leave_at_signals()
    open_streams()
