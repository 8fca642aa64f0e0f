"""Memory that a room's files would take, estimated from their headers without decoding them."""

import struct
import zlib
from pathlib import Path

from sim.errors import InputError

_PNG = b"\x89PNG\r\n\x1a\n"
_LONGEST_TEXT = 64 * 1024
"""Most bytes of compressed text in a PNG: text can inflate a thousandfold."""
_CHUNK = 1024 * 1024


def measure_picture(path: Path, what: str) -> tuple[int, int] | None:
    """Return width and height of a PNG file [px], or None for another format.

    Raises:
        InputError: The header is wrong, or the file holds more data than a picture of its size.
    """
    with path.open("rb") as file:
        head = file.read(33)
        if not head.startswith(_PNG):
            return None
        if len(head) < 33 or head[12:16] != b"IHDR":
            raise InputError(f"{what}: the PNG file has no header")
        width, height, depth, colour = struct.unpack(">IIBB", head[16:26])
        channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour)
        if not width or not height or channels is None or depth not in {1, 2, 4, 8, 16}:
            raise InputError(f"{what}: the header of the PNG file is wrong")
        # Each row has one byte for its filter; an interlaced picture has up to twice as many rows.
        raw = 2 * height + height * ((width * channels * depth + 7) // 8 + 8)
        _refuse_hidden(file, raw, what)
    return width, height


def measure_terrain(path: Path, what: str) -> int:
    """Return the cells of a height field: a PNG, or MuJoCo's own format of rows and columns (int32), then floats."""
    if size := measure_picture(path, what):
        return size[0] * size[1]
    with path.open("rb") as file:
        head = file.read(8)
    rows, columns = struct.unpack("<ii", head) if len(head) == 8 else (0, 0)
    if rows < 1 or columns < 1 or path.stat().st_size < 8 + 4 * rows * columns:
        raise InputError(f"{what}: the height field is cut short or is neither a PNG nor MuJoCo's own format")
    return rows * columns


def count_triangles(path: Path) -> int:
    """Estimate the triangles of a mesh file: by the lines of an OBJ file, by the size of any other."""
    if path.suffix.lower() != ".obj":
        return path.stat().st_size // (50 if path.suffix.lower() == ".stl" else 12)
    with path.open("rb") as file:
        return sum(part.count(b"\nf") for part in iter(lambda: file.read(_CHUNK), b""))


def _refuse_hidden(file, raw: int, what: str) -> None:
    """Refuse a PNG whose text or pixels inflate to more than a picture with ``raw`` bytes of pixels."""
    text, inflate, pixels = 0, zlib.decompressobj(), 0
    while len(head := file.read(8)) == 8:
        length, kind = struct.unpack(">I4s", head)
        if kind in {b"zTXt", b"iTXt", b"tEXt"}:
            text += length
        if text > _LONGEST_TEXT:
            raise InputError(f"{what}: the PNG file has more than {_LONGEST_TEXT // 1024} KiB of text in it")
        if kind == b"IDAT":
            pixels += _inflate(file, length, inflate, raw - pixels)
            file.seek(4, 1)
        else:
            file.seek(length + 4, 1)
        if pixels > raw:
            raise InputError(f"{what}: the PNG file has more pixels than its header says")


def _inflate(file, length: int, inflate, room: int) -> int:
    """Count the bytes that a chunk inflates to, up to just above ``room``, without keeping them."""
    found = 0
    while length > 0 and found <= room:
        part = file.read(min(length, _CHUNK))
        if not part:
            break
        length -= len(part)
        while part and found <= room and not inflate.eof:
            try:
                found += len(inflate.decompress(part, _CHUNK))
            except zlib.error:
                break  # MuJoCo reports what is wrong with it
            part = inflate.unconsumed_tail
    file.seek(length, 1)
    return found
