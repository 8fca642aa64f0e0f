"""Files in which any changed bit is noticed: JSON, arrays, text, and files with a checksum next to them.

JSON holds the SHA-256 of its own values, an archive of arrays (``.npz``) the CRC-32 of each, a text file its SHA-256 in
its first line; that of any other file is in a manifest, or in a file ``<name>.sha256`` next to it.
"""

import hashlib
import json
import logging
import math
import os
from collections.abc import Iterable, Mapping
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.lib import format as npy

from sim.errors import DamagedError, InputError, one_line
from sim.files.atomic import NO_SPACE, write_atomic, write_bytes, write_text

log = logging.getLogger(__name__)
SUM, CHECKSUM = ".sha256", "checksum"  # Suffix of a file of a checksum, and the key of the checksum in JSON
FORMAT = 2  # Number of the format of recordings, runs and studies; format 1 is that of deepgps 0.1.0
HEADER_START = f"# deepgps format {FORMAT}; sha256 of the lines below: "


def damaged(path: Path, reason: str = "it differs from its checksum") -> DamagedError:
    """Return the error for a finished file that is damaged."""
    return DamagedError(f"{path} is damaged: {reason[:200]}")


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sha256(path: Path, expected: str) -> None:
    """Compare a file with its checksum, once per process as long as the file does not change; raises DamagedError."""
    try:
        now = path.stat()
    except FileNotFoundError:
        raise DamagedError(f"{path} is missing") from None
    if _sha256_once(path.absolute(), now.st_ino, now.st_size, now.st_mtime_ns) != expected:
        raise damaged(path)


def write_lines(path: Path, text: str) -> None:
    """Write a text file, such as YAML, with its checksum in a comment in the first line."""
    write_text(path, f"{HEADER_START}{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


def check_lines(path: Path) -> None:
    """Compare a text file with the checksum in its first line.

    Raises DamagedError if it differs, InputError if it is of another format.
    """
    head, _, text = path.read_bytes().partition(b"\n")
    if head.startswith(b"# sha256") or not head.startswith(b"#"):
        raise refuse_format(path)
    if head.decode(errors="replace").removeprefix(HEADER_START) != hashlib.sha256(text).hexdigest():
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


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file atomically, with keys in the order given and a checksum of all values last."""
    sealed = {**value, CHECKSUM: _digest_json(value)}
    write_text(path, json.dumps(sealed, indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that ``write_json`` made; raises DamagedError if it is missing, truncated or changed."""
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


def _digest_json(value: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(value, indent=1).encode()).hexdigest()


def write_array(path: Path, array: np.ndarray) -> None:
    """Write one ``.npy`` file atomically."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.save(file, array, allow_pickle=False)

    write_atomic(path, write, array.nbytes)


def write_blocks(path: Path, shape: tuple[int, ...], dtype: np.dtype, blocks: Iterable[np.ndarray]) -> None:
    """Write one ``.npy`` file atomically, block of rows by block, with the bytes that ``write_array`` gives the whole.

    The file is not memory-mapped, since a full disk kills a process that writes to mapped memory.
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

    Raises DamagedError if the file is missing, truncated or changed.
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


def _reserve(file: IO[bytes], size: int) -> None:
    """Reserve the space of a file that is being written, so that a full disk is detected at once."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except (OSError, AttributeError) as error:  # not supported by the file system or platform: writing will find out
        if isinstance(error, OSError) and error.errno in NO_SPACE:
            raise
