"""Folders with files of known names: listing, removing and locking them."""

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sim.files.atomic import PART


def lock(handle: int, path: Path) -> bool:
    """Lock an open file or folder against other processes; a dead process holds no lock.

    Returns:
        False if another process holds it, or the one that held it has just removed ``path``.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.fstat(handle).st_ino == path.stat().st_ino
    except (BlockingIOError, FileNotFoundError):
        return False


@contextmanager
def only_process(folder: Path) -> Iterator[None]:
    """Make a folder and wait until no other process is in this context with it; a dead process is in none."""
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def remove_files(folder: Path, ours: re.Pattern[str]) -> None:
    """Remove files and links below a folder whose paths in it match, also half-written ones, and the emptied folders.

    All other files stay, and so do their folders. Symbolic links are removed, never followed.
    """
    for path in list_files(folder, ours):
        path.unlink(missing_ok=True)
        remove_empty(path.parent, folder.parent)
    remove_empty(folder, folder.parent)


def remove_empty(folder: Path, top: Path) -> None:
    """Remove a folder and its parents below ``top``, as long as they are empty."""
    while folder != top:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent


def sweep(folder: Path, ours: re.Pattern[str]) -> None:
    """Remove the half-written files that a killed process left below a folder, if their paths in it match."""
    for path in list_files(folder, ours, parts_only=True):
        path.unlink(missing_ok=True)
        remove_empty(path.parent, folder)


def list_files(folder: Path, ours: re.Pattern[str], parts_only: bool = False) -> list[Path]:
    """Files and links below a folder whose paths in it match, including half-written ones."""
    found = []
    for place, folders, names in os.walk(folder):
        here = Path(place)
        links = [name for name in folders if (here / name).is_symlink()]
        for name in [*names, *links]:
            inside = (here / name).relative_to(folder).as_posix()
            whole = _WRITING.sub("", inside)
            if ours.fullmatch(whole) and (whole != inside or not parts_only):
                found.append(here / name)
    return found


_WRITING = re.compile(rf"\.\d+{re.escape(PART)}(?=/|$)")
