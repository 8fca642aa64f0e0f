"""Files that are either the old or the new one, never half, and that tell when a bit of them has changed.

Every file is written aside, synced and renamed. What a later stage reads is checked: JSON carries the SHA-256 of its
own values, ``.npz`` archives the CRC-32 of each array, and other files are named with their SHA-256 in a JSON file or
in a file ``<name>.sha256`` beside them.
"""

import errno
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
"""End of the names of files and folders that are being written: ``<name>.<process>.deepgps-part``."""
CHECKSUM = "checksum"
SUM = ".sha256"
LINES = "# sha256 of the lines below: "
NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
PROBE = 1 << 20
"""Bytes by which a file is made to grow, at most, to find out whether the disk is full."""


def write_atomic(path: Path, write: Callable[[Path], object], size: int = 0) -> None:
    """Let ``write`` make a file beside ``path``, sync it to disk and rename it to ``path``.

    Args:
        path: The file.
        write: Writes the file that it is given.
        size: How many bytes it is going to write, where that is known.

    Raises:
        WorkError: The disk is full, and then it says how much is needed and how much is free; or it fails.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}{PART}")  # an orphan of a killed run may still write its own
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
        _sync_folder(path.parent)
    except (InputError, WorkError):
        part.unlink(missing_ok=True)
        raise
    except Exception as error:
        needed = max(size, part.stat().st_size if part.is_file() else 0)
        lack = _find_lack(part, error, max(size, PROBE))
        with suppress(OSError):
            part.unlink()
        if lack:
            raise WorkError(describe_lack(path, needed, lack)) from None
        if isinstance(error, OSError) and error.errno and error.filename is None:
            raise WorkError(f"{path} cannot be written: {error.strerror}") from None
        raise


def check_space(path: Path, needed: int) -> None:
    """Raise WorkError where so many bytes [needed] cannot be written at ``path``, before anything is."""
    place = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    if shutil.disk_usage(place).free < needed:
        raise WorkError(describe_lack(path, needed, OSError(errno.ENOSPC, "")))


def describe_lack(path: Path, needed: int, error: OSError) -> str:
    """One line about a file for which there is no space: its path, the bytes needed and free, and why."""
    place = next(folder for folder in path.absolute().parents if folder.exists())
    free = shutil.disk_usage(place).free
    return (
        f"{path} cannot be written: {os.strerror(error.errno or errno.ENOSPC)}; at least {write_size(needed)} are "
        f"needed and {write_size(free)} are free; with more space the same command continues"
    )


def write_size(size: int) -> str:
    """A number of bytes with a unit."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size} bytes"


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a binary file atomically."""
    write_atomic(path, lambda part: part.write_bytes(data), len(data))


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file atomically, keys in the order given, and last the checksum of them all."""
    sealed = {**value, CHECKSUM: _digest_json(value)}
    write_text(path, json.dumps(sealed, indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that ``write_json`` made; files of earlier versions have no checksum, and are taken as they are.

    Raises:
        DamagedError: The file is missing, is cut off or has changed.
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
    """Write one ``.npy`` file atomically, block after block: the same bytes as ``write_array`` of the whole.

    Nothing is mapped to memory, for a full disk ends a process that writes to such memory.

    Args:
        path: The file.
        shape: Shape of the whole array.
        dtype: Its type.
        blocks: Its rows in order, some at a time.
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
    """Read all arrays of a file that ``write_arrays`` made, each compared with its checksum.

    Raises:
        DamagedError: The file is missing, is cut off or has changed.
    """
    try:
        data = path.read_bytes()
        with ZipFile(BytesIO(data)) as archive:
            entries = archive.infolist()
            # The last 22 bytes count the entries; zipfile itself does not miss one that has been lost.
            if len(entries) != int.from_bytes(data[-12:-10], "little"):
                raise damaged(path, "an array is missing")
            if any(entry.compress_type != ZIP_STORED for entry in entries):
                raise damaged(path, "its arrays are compressed")
            # Reading an entry whole compares its CRC-32, before NumPy believes anything of it.
            stored = {entry.filename.removesuffix(".npy"): archive.read(entry) for entry in entries}
        return {name: np.load(BytesIO(array), allow_pickle=False) for name, array in stored.items()}
    except DamagedError:
        raise
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    except Exception as error:  # zipfile, struct and NumPy raise a dozen kinds
        raise damaged(path, one_line(error)) from None


def damaged(path: Path, reason: str = "it differs from its checksum") -> DamagedError:
    """The error for a file that was written whole and is not so any more."""
    return DamagedError(f"{path} is damaged: {reason[:200]}")


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sha256(path: Path, expected: str) -> None:
    """Compare a file with its checksum, once in a process for as long as it does not change.

    Raises:
        DamagedError: It is missing, or differs.
    """
    try:
        now = path.stat()
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    if _sha256_once(path.absolute(), now.st_ino, now.st_size, now.st_mtime_ns) != expected:
        raise damaged(path)


def write_lines(path: Path, text: str) -> None:
    """Write a text file, such as YAML, beneath a comment that holds its checksum."""
    write_text(path, f"{LINES}{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


def check_lines(path: Path) -> None:
    """Compare a text file with the checksum in its first line, where there is one; raises DamagedError."""
    head, _, text = path.read_bytes().partition(b"\n")
    expected = head.decode(errors="replace").removeprefix(LINES)
    if head.startswith(b"#") and expected != hashlib.sha256(text).hexdigest():
        raise damaged(path)


def write_sum(path: Path) -> None:
    """Write the checksum of a file beside it, in the format of sha256sum."""
    write_text(path.with_name(path.name + SUM), f"{sha256(path)}  {path.name}\n")


def drop_sum(path: Path) -> None:
    """Forget the checksum of a file that is about to be written again."""
    path.with_name(path.name + SUM).unlink(missing_ok=True)


def check_sum(path: Path) -> None:
    """Compare a file with the checksum beside it, where there are both; raises DamagedError."""
    beside = path.with_name(path.name + SUM)
    if beside.is_file() and path.is_file():
        check_sha256(path, beside.read_text(errors="replace").partition(" ")[0])


def is_intact(path: Path) -> bool:
    """Whether a file is there, and as its checksum beside it says; says so of one that has to be made again."""
    try:
        check_sum(path)
    except DamagedError as error:
        log.warning("%s; it is made again", error)
        return False
    return path.is_file()


def link_file(source: Path, target: Path) -> None:
    """Make a file the same as another: a hard link, or a copy where there can be none."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        write_atomic(target, lambda part: shutil.copyfile(source, part), source.stat().st_size)


def remove_files(folder: Path, ours: re.Pattern[str]) -> None:
    """Remove the files and links below a folder whose paths in it match, half-written ones too; and folders so emptied.

    Everything else stays, and so do the folders that hold it. LoopClosures are removed, never followed.
    """
    for path in list_files(folder, ours):
        path.unlink(missing_ok=True)
        remove_empty(path.parent, folder.parent)
    remove_empty(folder, folder.parent)


def remove_empty(folder: Path, top: Path) -> None:
    """Remove a folder and those above it up to ``top``, which stays, as far as they are empty."""
    while folder != top:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent


def sweep(folder: Path, ours: re.Pattern[str]) -> None:
    """Remove what a killed process left half-written of files below a folder whose paths in it match."""
    for path in list_files(folder, ours, parts_only=True):
        path.unlink(missing_ok=True)
        remove_empty(path.parent, folder)


def list_files(folder: Path, ours: re.Pattern[str], parts_only: bool = False) -> list[Path]:
    """Files and links below a folder whose paths in it match, or that are half-written ones of such a name."""
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


def check_overwrite(path: Path, is_ours: Callable[[bytes], bool]) -> None:
    """Raise InputError where a file could not be written without losing one that somebody else made."""
    if path.is_symlink() or (path.exists() and not (path.is_file() and is_ours(path.read_bytes()))):
        raise InputError(f"{path} exists, and deepgps did not write it: choose another name, or move it away")


_WRITING = re.compile(rf"\.\d+{re.escape(PART)}(?=/|$)")


@lru_cache(maxsize=4096)
def _sha256_once(path: Path, inode: int, size: int, changed_ns: int) -> str:
    return sha256(path)


def _digest_json(value: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(value, indent=1).encode()).hexdigest()


def _reserve(file: IO[bytes], size: int) -> None:
    """Claim the space of a file that is being written, so that a full disk is found at once."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except (OSError, AttributeError) as error:  # a file system or a platform that cannot: writing finds out
        if isinstance(error, OSError) and error.errno in NO_SPACE:
            raise


def _find_lack(part: Path, error: Exception, size: int) -> OSError | None:
    """The error of a full disk, if that is why writing failed: many libraries raise one of their own instead."""
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
