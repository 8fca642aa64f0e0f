"""What the command does before it imports anything else, which takes a second: it is the first import of its file."""

import sys
import time
from multiprocessing import parent_process
from pathlib import Path

from deepgps.outlets import open_streams
from deepgps.signals import leave_at_signals

BEGUN = time.monotonic()
FILES = {"deepgps", "cli.py"}
"""How the command is started: as the script of the package, or as ``python -m deepgps.cli``."""

if Path(sys.argv[0]).name in FILES:  # not in a program that only imports a part of the command
    open_streams()
    if parent_process() is None:
        leave_at_signals()
