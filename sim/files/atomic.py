"""Atomic files, each either the old or the new one, and folders with files of known names.

A file is written under a temporary name, synced and renamed. Folders are listed, locked
and emptied of our files alone.
"""

import errno
import fcntl
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sim.errors import InputError, WorkError

PART = ".deepgps-part"  # Suffix of files and folders that are being written: ``<name>.<process>.deepgps-part``
_PART_NAME = re.compile(rf"\.\d+{re.escape(PART)}(?=/|$)")
NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
PROBE_BYTES = 1 << 20
"""Bytes per block, and the fewest in all, that are appended to a file to find out whether the disk is full."""


def write_atomic(path: Path, write: Callable[[Path], object], size: int = 0) -> None:
    """Let ``write`` make a file next to ``path``, sync it to disk and rename it to ``path``.

    Raises WorkError if writing fails or the disk is full; the message states the space needed, if it is known, and
    free.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}{PART}")  # an orphan of a killed run may still write its file
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
        _sync_folder(path.parent)
    except BaseException as error:  # Ctrl-C too
        there = part.stat().st_size if part.is_file() else 0
        lack = _find_lack(part, error, max(size - there, PROBE_BYTES))
        with suppress(OSError):
            part.unlink()
        if lack:
            raise WorkError(describe_lack(path, max(size, there), lack)) from None
        if isinstance(error, OSError) and error.errno and error.filename is None:
            raise WorkError(f"{path} cannot be written: {error.strerror}") from None
        raise


def check_space(path: Path, needed: int) -> None:
    """Raise WorkError if ``needed`` bytes cannot be written at ``path``, before anything is written."""
    if shutil.disk_usage(find_existing(path)).free < needed:
        raise WorkError(describe_lack(path, needed, OSError(errno.ENOSPC, "")))


def describe_lack(path: Path, needed: int, error: OSError) -> str:
    """One-line message about a file without space: its path, the bytes needed and free, and the reason."""
    free = shutil.disk_usage(find_existing(path.parent)).free
    why = os.strerror(error.errno or errno.ENOSPC)
    lack = f"{path} cannot be written: {why}; at least {write_size(needed)} are needed"
    if error.errno == errno.EFBIG:
        return f"{lack}; with a higher limit of the size of files (ulimit -f) the same command continues"
    return f"{lack} and {write_size(free)} are free; with more space the same command continues"


def find_existing(path: Path) -> Path:
    """A path if it exists, else the nearest folder above it that does."""
    return next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())


def write_size(size: int) -> str:
    """Format a number of bytes with a unit."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size} bytes"


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a binary file atomically."""
    write_atomic(path, lambda part: part.write_bytes(data), len(data))


def link_file(source: Path, target: Path) -> None:
    """Make a file the same as another: a hard link, or a copy where links are impossible."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        write_atomic(target, lambda part: shutil.copyfile(source, part), source.stat().st_size)
    else:
        _sync_folder(target.parent)


def check_overwrite(path: Path, is_ours: Callable[[bytes], bool], head: int = -1) -> None:
    """Raise InputError if a file is there whose first ``head`` bytes (-1: all) do not tell that deepgps wrote it."""
    if path.is_symlink() or (path.exists() and not (path.is_file() and is_ours(_read_head(path, head)))):
        raise InputError(f"{path} exists, and deepgps did not write it: choose another name, or move it away")


def _read_head(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


def _find_lack(part: Path, error: BaseException, size: int) -> OSError | None:
    """The error of a full disk, if that is why writing failed: many libraries raise their own error instead."""
    if isinstance(error, InputError | WorkError) or not isinstance(error, Exception):
        return None
    if isinstance(error, OSError) and error.errno:
        return error if error.errno in NO_SPACE else None
    try:
        with part.open("ab") as file:
            for _ in range(0, size, PROBE_BYTES):
                file.write(bytes(PROBE_BYTES))
    except OSError as found:
        return found if found.errno in NO_SPACE else None
    return None


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def lock(handle: int, path: Path) -> bool:
    """Lock an open file or folder against other processes; a dead process holds no lock.

    Returns False if another process holds it, or the one that held it has just removed ``path``.
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
            whole = _PART_NAME.sub("", inside)
            if ours.fullmatch(whole) and (whole != inside or not parts_only):
                found.append(here / name)
    return found
