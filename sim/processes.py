"""Worker processes that do not outlive the process that started them."""

import os
import threading
from multiprocessing import parent_process


def end_with_parent() -> None:
    """In a worker: end it when its parent is gone, be that killed before the first job came."""
    threading.Thread(target=_wait_and_end, daemon=True).start()


def _wait_and_end() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
