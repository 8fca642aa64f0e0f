"""Array files; the archives (``.npz``) hold the CRC-32 of each array."""

import math
import os
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import IO
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.lib import format as npy

from sim.errors import DamagedError, one_line
from sim.files.atomic import NO_SPACE, write_atomic
from sim.files.checksums import damaged


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


def _reserve(file: IO[bytes], size: int) -> None:
    """Reserve the space of a file that is being written, so that a full disk is detected at once."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except (OSError, AttributeError) as error:  # not supported by the file system or platform: writing will find out
        if isinstance(error, OSError) and error.errno in NO_SPACE:
            raise
