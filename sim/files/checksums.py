"""Checksums of files: in their first line, or in a file ``<name>.sha256`` next to them."""

import hashlib
import logging
import os
from functools import lru_cache
from pathlib import Path

from sim.errors import DamagedError, InputError
from sim.files.atomic import write_bytes, write_text

log = logging.getLogger(__name__)
SUM = ".sha256"
FORMAT = 2
"""Number of the format of recordings, runs and studies; format 1 is that of deepgps 0.1.0."""
LINES = f"# deepgps format {FORMAT}; sha256 of the lines below: "


def damaged(path: Path, reason: str = "it differs from its checksum") -> DamagedError:
    """Return the error for a finished file that is damaged."""
    return DamagedError(f"{path} is damaged: {reason[:200]}")


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sha256(path: Path, expected: str) -> None:
    """Compare a file with its checksum, once per process as long as the file does not change.

    Raises:
        DamagedError: The file is missing or differs.
    """
    try:
        now = path.stat()
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    if _sha256_once(path.absolute(), now.st_ino, now.st_size, now.st_mtime_ns) != expected:
        raise damaged(path)


def write_lines(path: Path, text: str) -> None:
    """Write a text file, such as YAML, with its checksum in a comment in the first line."""
    write_text(path, f"{LINES}{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


def check_lines(path: Path) -> None:
    """Compare a text file with the checksum in its first line.

    Raises:
        InputError: It is of another format.
        DamagedError: It differs from its checksum.
    """
    head, _, text = path.read_bytes().partition(b"\n")
    if head.startswith(b"# sha256") or not head.startswith(b"#"):
        raise refuse_format(path)
    if head.decode(errors="replace").removeprefix(LINES) != hashlib.sha256(text).hexdigest():
        raise damaged(path)


def refuse_format(path: Path, number: object = None) -> InputError:
    """Return the error for a file of another format than this version's; None: it has no number, as in format 1."""
    if number in {None, 1}:
        return InputError(f"{path}: made by deepgps 0.1.0, format 1: make it again, or use deepgps 0.1.0")
    return InputError(f"{path}: format {str(number)[:20]}, but this version of deepgps reads format {FORMAT}")


def write_sum(path: Path) -> None:
    """Write the checksum of a file next to it, in the format of sha256sum."""
    # A name need not be text.
    write_bytes(path.with_name(path.name + SUM), sha256(path).encode() + b"  " + os.fsencode(path.name) + b"\n")


def drop_sum(path: Path) -> None:
    """Delete the checksum of a file that is about to be rewritten."""
    path.with_name(path.name + SUM).unlink(missing_ok=True)


def check_sum(path: Path) -> None:
    """Compare a file with the checksum next to it, if both exist; raises DamagedError."""
    beside = path.with_name(path.name + SUM)
    if beside.is_file() and path.is_file():
        check_sha256(path, beside.read_text(errors="replace").partition(" ")[0])


def is_intact(path: Path) -> bool:
    """Whether a file exists and matches the checksum next to it; logs a warning if it does not match."""
    try:
        check_sum(path)
    except DamagedError as error:
        log.warning("%s; it is made again", error)
        return False
    return path.is_file()


@lru_cache(maxsize=4096)
def _sha256_once(path: Path, inode: int, size: int, changed_ns: int) -> str:
    return sha256(path)
