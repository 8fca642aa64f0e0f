"""Count the modules of sim and deepgps whose functions ``deepgps run tiny`` enters before its drive begins.

Usage: python tests/modules_entered.py [WORD ...]; the words are those after ``deepgps``. Run it in an empty folder.
"""

import inspect
import os
import sys
import threading
from types import FrameType

BEGINS = ("sim.recording.collect", "_drive")
"""Module and function with which the drive begins; then the process ends."""
entered: set[str] = set()


def note(frame: FrameType, event: str, _: object) -> None:
    """Note the module of a function that is called; bodies of modules and classes are no functions."""
    module, code = frame.f_globals.get("__name__", ""), frame.f_code
    if event == "call" and module.startswith(("sim.", "deepgps.")) and code.co_flags & inspect.CO_OPTIMIZED:
        entered.add(module)
        if (module, code.co_name) == BEGINS:
            print("\n".join(sorted(entered)), f"\n{len(entered)} modules", flush=True)
            os._exit(0)


threading.setprofile(note)
sys.setprofile(note)
sys.argv = ["deepgps", *(sys.argv[1:] or ["run", "tiny"])]
from deepgps.commands.main import main  # noqa: E402 (the profile comes first)

main()
