"""Atomic, checksummed files: a file is either the old or the new one, and any changed bit is detected.

Every file is written under a temporary name, synced and renamed. Files that a later stage reads are checked: JSON
contains the SHA-256 of its own values, ``.npz`` archives the CRC-32 of each array, and the SHA-256 of other files is in
a JSON file or in a file ``<name>.sha256`` next to them.
"""

import errno
import fcntl
import hashlib
import json
import logging
import math
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.lib import format as npy

from sim.errors import DamagedError, InputError, WorkError, one_line

log = logging.getLogger(__name__)
PART = ".deepgps-part"
"""Suffix of files and folders that are being written: ``<name>.<process>.deepgps-part``."""
CHECKSUM = "checksum"
SUM = ".sha256"
LINES = "# sha256 of the lines below: "
NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
PROBE = 1 << 20
"""Bytes per block, and the fewest in all, that are appended to a file to find out whether the disk is full."""


def write_atomic(path: Path, write: Callable[[Path], object], size: int = 0) -> None:
    """Let ``write`` make a file next to ``path``, sync it to disk and rename it to ``path``.

    Args:
        path: The file.
        write: Writes to the path that it is given.
        size: Number of bytes that it will write, if known.

    Raises:
        WorkError: The disk is full (the message states the space needed and free), or writing fails.
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
        lack = _find_lack(part, error, max(size - there, PROBE))
        with suppress(OSError):
            part.unlink()
        if lack:
            raise WorkError(describe_lack(path, max(size, there), lack)) from None
        if isinstance(error, OSError) and error.errno and error.filename is None:
            raise WorkError(f"{path} cannot be written: {error.strerror}") from None
        raise


def check_space(path: Path, needed: int) -> None:
    """Raise WorkError if ``needed`` bytes cannot be written at ``path``, before anything is written."""
    place = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    if shutil.disk_usage(place).free < needed:
        raise WorkError(describe_lack(path, needed, OSError(errno.ENOSPC, "")))


def describe_lack(path: Path, needed: int, error: OSError) -> str:
    """One-line message about a file without space: its path, the bytes needed and free, and the reason."""
    place = next(folder for folder in path.absolute().parents if folder.exists())
    free = shutil.disk_usage(place).free
    return (
        f"{path} cannot be written: {os.strerror(error.errno or errno.ENOSPC)}; at least {write_size(needed)} are "
        f"needed and {write_size(free)} are free; with more space the same command continues"
    )


def write_size(size: int) -> str:
    """Format a number of bytes with a unit."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size} bytes"


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a binary file atomically."""
    write_atomic(path, lambda part: part.write_bytes(data), len(data))


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file atomically, with keys in the order given and a checksum of all values last."""
    sealed = {**value, CHECKSUM: _digest_json(value)}
    write_text(path, json.dumps(sealed, indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that ``write_json`` made; files of earlier versions have no checksum and are not checked.

    Raises:
        DamagedError: The file is missing, truncated or changed.
    """
    try:
        value = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    except (ValueError, RecursionError) as error:
        raise damaged(path, f"it is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise damaged(path, f"it holds a {type(value).__name__} and no mapping")
    expected = value.pop(CHECKSUM, None)
    if expected is not None and expected != _digest_json(value):
        raise damaged(path)
    return value


def write_array(path: Path, array: np.ndarray) -> None:
    """Write one ``.npy`` file atomically."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.save(file, array, allow_pickle=False)

    write_atomic(path, write, array.nbytes)


def write_blocks(path: Path, shape: tuple[int, ...], dtype: np.dtype, blocks: Iterable[np.ndarray]) -> None:
    """Write one ``.npy`` file atomically, block by block: the same bytes as ``write_array`` of the complete array.

    The file is not memory-mapped, since a full disk kills a process that writes to mapped memory.

    Args:
        path: The file.
        shape: Shape of the complete array.
        dtype: Its data type.
        blocks: Its rows in order, in blocks.
    """
    size = math.prod(shape) * dtype.itemsize

    def write(part: Path) -> None:
        with part.open("wb") as file:
            header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
            npy.write_array_header_1_0(file, header)
            end = file.tell() + size
            _reserve(file, end)
            for block in blocks:
                file.write(np.ascontiguousarray(block, dtype).data)
            if file.tell() != end:
                raise ValueError(f"{path}: blocks of {file.tell() - end + size} bytes for an array of {size}")

    write_atomic(path, write, size)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write one uncompressed ``.npz`` file atomically; equal arrays give equal bytes."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)  # pyright: ignore[reportArgumentType]

    write_atomic(path, write, sum(np.asarray(array).nbytes for array in arrays.values()))


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read all arrays of a file that ``write_arrays`` made and compare each with its checksum.

    Raises:
        DamagedError: The file is missing, truncated or changed.
    """
    try:
        data = path.read_bytes()
        with ZipFile(BytesIO(data)) as archive:
            entries = archive.infolist()
            # The last 22 bytes hold the number of entries; zipfile itself does not notice a missing entry.
            if len(entries) != int.from_bytes(data[-12:-10], "little"):
                raise damaged(path, "an array is missing")
            if any(entry.compress_type != ZIP_STORED for entry in entries):
                raise damaged(path, "its arrays are compressed")
            # Reading a complete entry compares its CRC-32 before NumPy parses it.
            stored = {entry.filename.removesuffix(".npy"): archive.read(entry) for entry in entries}
        return {name: np.load(BytesIO(array), allow_pickle=False) for name, array in stored.items()}
    except DamagedError:
        raise
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    except Exception as error:  # zipfile, struct and NumPy raise a dozen types
        raise damaged(path, one_line(error)) from None


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
    """Compare a text file with the checksum in its first line, if there is one; raises DamagedError."""
    head, _, text = path.read_bytes().partition(b"\n")
    expected = head.decode(errors="replace").removeprefix(LINES)
    if head.startswith(b"#") and expected != hashlib.sha256(text).hexdigest():
        raise damaged(path)


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


def check_overwrite(path: Path, is_ours: Callable[[bytes], bool], head: int = -1) -> None:
    """Raise InputError if writing a file would overwrite one that deepgps did not write.

    Args:
        path: The file.
        is_ours: Whether deepgps wrote a file with these contents.
        head: Number of its first bytes that are enough to tell; -1: all are needed.
    """
    if path.is_symlink() or (path.exists() and not (path.is_file() and is_ours(_read_head(path, head)))):
        raise InputError(f"{path} exists, and deepgps did not write it: choose another name, or move it away")


def _read_head(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


_WRITING = re.compile(rf"\.\d+{re.escape(PART)}(?=/|$)")


@lru_cache(maxsize=4096)
def _sha256_once(path: Path, inode: int, size: int, changed_ns: int) -> str:
    return sha256(path)


def _digest_json(value: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(value, indent=1).encode()).hexdigest()


def _reserve(file: IO[bytes], size: int) -> None:
    """Reserve the space of a file that is being written, so that a full disk is detected at once."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except (OSError, AttributeError) as error:  # not supported by the file system or platform: writing will find out
        if isinstance(error, OSError) and error.errno in NO_SPACE:
            raise


def _find_lack(part: Path, error: BaseException, size: int) -> OSError | None:
    """The error of a full disk, if that is why writing failed: many libraries raise their own error instead."""
    if isinstance(error, InputError | WorkError) or not isinstance(error, Exception):
        return None
    if isinstance(error, OSError) and error.errno:
        return error if error.errno in NO_SPACE else None
    try:
        with part.open("ab") as file:
            for _ in range(0, size, PROBE):
                file.write(bytes(PROBE))
    except OSError as found:
        return found if found.errno in NO_SPACE else None
    return None


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
