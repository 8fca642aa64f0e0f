"""Folders that belong to deepgps: marked, locked by one process at a time, and replaced completely or not at all.

The mark is a file with a name that nothing else writes. In a marked folder only files of known names are written and
removed; other files that a user puts there stay. A folder that is not empty and has no mark is left alone.
"""

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from sim.errors import InputError
from sim.files.atomic import list_files, lock, remove_empty, remove_files
from sim.files.checksums import read_json, write_json

MARK = ".deepgps"
FRESH_FOLDER = ".deepgps-fresh"  # Folder within an owned folder in which ``--fresh`` builds what will replace the rest
COMPLETION_FILE = "complete.json"


@dataclass(frozen=True)
class Kind:
    """A kind of folder."""

    name: str  # Name of the kind in the mark and in messages
    first: str  # The file that is written first
    # Returns the pattern of the paths, within the folder, of all files that deepgps writes
    find_files: Callable[[], re.Pattern[str]]

    @property
    def files(self) -> re.Pattern[str]:
        """Pattern of the paths, within the folder, of all files that deepgps writes."""
        return self.find_files()

    @property
    def head(self) -> str:
        """The first words of the mark."""
        return f"deepgps {self.name} folder"

    @property
    def text(self) -> str:
        """Contents of the mark."""
        return f"{self.head}: deepgps writes and removes files of its own here, and no others.\n"


def choose_place(folder: Path, kind: Kind, fresh: bool) -> Path:
    """The folder to work in: ``folder`` itself, or, with ``fresh`` and work already there, a subfolder."""
    begun = (folder / kind.first).is_file()
    return folder / FRESH_FOLDER if fresh and begun else folder


@contextmanager
def hold(folder: Path, kind: Kind, named: str = "--out") -> Iterator[None]:
    """Lock an owned folder, or one that becomes owned, against other processes; a dead process holds no lock.

    An interrupted replacement is finished first. A folder that holds nothing at the end is left as it was found. Raises
    InputError if the folder holds something that is not deepgps's, cannot be written, or is in use; what messages write
    before its path is the option that gave it, or what it is.
    """
    check_owner(folder, kind, named)
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Whatever has this name, no link is followed and nothing is truncated.
        mark = os.open(folder / MARK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise InputError(f"{named} {folder} cannot be written: {error.strerror}") from None
    try:
        if not lock(mark, folder / MARK):
            raise InputError(f"{named} {folder} is in use by another process")
        try:
            if os.fstat(mark).st_size == 0:
                os.write(mark, kind.text.encode())
                os.fsync(mark)
            finish_replacement(folder, kind)
            yield
        finally:
            _leave(folder, created)
    finally:
        os.close(mark)


def check_owner(folder: Path, kind: Kind, named: str) -> None:
    """Raise InputError for a folder that is not empty and has no mark of this kind; ``named`` as in ``hold``."""
    try:
        names = os.listdir(folder) if folder.exists() else []
        if not names:
            return
        text = _read_mark(folder / MARK)
    except NotADirectoryError:
        raise InputError(f"{named} {folder} is a file, and must be a folder") from None
    except OSError as error:
        raise InputError(f"{named} {folder} cannot be read: {error.strerror}") from None
    if (text or "").startswith(kind.head) or (text == "" and names == [MARK]):
        return
    if text is not None:
        other = re.match(r"deepgps (\w+) folder", text)
        what = f"says that it is a {other[1]} folder" if other else "is damaged, or not from deepgps"
        raise InputError(
            f"{named} {folder}: its mark {MARK} {what}; choose another folder for a {kind.name}, or, if it is one, "
            f"write '{kind.head}' into the mark"
        )
    raise InputError(
        f"{named} {folder} is neither empty nor a {kind.name} folder of deepgps; nothing in it is touched: "
        "choose another folder"
    )


def replace(folder: Path, kind: Kind) -> None:
    """Replace the folder's files by those that ``--fresh`` has built; if interrupted, this is finished later.

    Raises InputError if a file of somebody else's is in a folder that a file or link must replace.
    """
    fresh = folder / FRESH_FOLDER
    built = [path.relative_to(fresh).as_posix() for path in list_files(fresh, kind.files)]
    _refuse_blocked(folder, kind, built)
    write_json(fresh / COMPLETION_FILE, {"files": built})
    finish_replacement(folder, kind)


def finish_replacement(folder: Path, kind: Kind) -> None:
    """Finish a replacement that was begun: remove the old files that do not stay, then move the new ones there.

    In this order no new file is moved through an old link, such as that to a recording elsewhere.
    """
    fresh = folder / FRESH_FOLDER
    if not (fresh / COMPLETION_FILE).is_file():
        return
    built = set(read_json(fresh / COMPLETION_FILE)["files"])
    for path in list_files(folder, kind.files):
        if path.relative_to(folder).as_posix() not in built:
            path.unlink()
            remove_empty(path.parent, folder)
    for name in built:
        if os.path.lexists(fresh / name):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (fresh / name).replace(folder / name)
            remove_empty((fresh / name).parent, fresh)
    (fresh / COMPLETION_FILE).unlink()
    remove_empty(fresh, folder)


def _refuse_blocked(folder: Path, kind: Kind, built: list[str]) -> None:
    ours = set(list_files(folder, kind.files))
    fresh, home, disk = (folder / FRESH_FOLDER).resolve(), folder.resolve(), folder.stat().st_dev
    for path in sorted({folder / parent for name in built for parent in Path(name).parents[:-1]}):
        if path not in ours and path.exists() and (path.is_symlink() or path.stat().st_dev != disk):
            raise InputError(f"--out {folder}: {path} is a link or another disk; nothing was replaced: move it away")
    for name in built:
        link = fresh / name
        if link.is_symlink() and link.resolve().is_relative_to(home) and not link.resolve().is_relative_to(fresh):
            raise InputError(f"--out {folder}: the new {name} is a link to {link.resolve()}, which would be replaced")
        if (folder / name).is_dir() and not (folder / name).is_symlink():
            inside = [path for path in (folder / name).rglob("*") if path.is_symlink() or not path.is_dir()]
            if foreign := sorted(set(inside) - ours):
                raise InputError(f"--out {folder}: {foreign[0]} is not deepgps's; nothing was replaced: move it away")


def discard(folder: Path, place: Path, kind: Kind) -> None:
    """Remove all files that deepgps wrote in ``place``."""
    remove_files(place, kind.files)
    if place != folder:
        remove_empty(place, folder)


def _read_mark(path: Path) -> str | None:
    """Contents of a mark; None if the file does not exist or is a link."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    with open(handle, "rb") as file:
        return file.read(1000).decode(errors="replace")


def _leave(folder: Path, created: list[Path]) -> None:
    """Remove the mark of a folder that holds nothing else, and the folders that were made for it."""
    with suppress(OSError):  # another run may have begun in one of them
        if os.listdir(folder) == [MARK]:
            (folder / MARK).unlink()
            for path in created:
                path.rmdir()
