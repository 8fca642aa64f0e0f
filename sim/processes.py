"""Worker processes: how many, and none that outlives the process that started it."""

import os
import threading
from multiprocessing import parent_process


def usable_cores() -> int:
    """Cores that this process may use: of a machine's many, a container or a batch system may give it a few."""
    return len(os.sched_getaffinity(0))


def end_with_parent() -> None:
    """In a worker: end it when its parent is gone, be that killed before the first job came."""
    threading.Thread(target=_wait_and_end, daemon=True).start()


def _wait_and_end() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
