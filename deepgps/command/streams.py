"""Standard streams that take every text, whoever reads them, and that are open."""

import errno
import io
import os
import sys
from contextlib import suppress
from typing import TextIO

UNREAD = (errno.EPIPE, errno.EIO)  # a pipe that is closed at its other end, a terminal that is gone


def open_streams() -> None:
    """Make standard output and errors of this process such streams; where one is closed, it is ``/dev/null``.

    Text that the encoding lacks is written as escapes. What nobody reads any more is dropped, and the work goes on.
    """
    _open_missing()
    sys.stdout = _wrap(sys.stdout, 1)
    sys.stderr = _wrap(sys.stderr, 2)


def flush_streams() -> None:
    """Write what still waits to be written; raises OSError where that fails, and lets it wait no longer."""
    for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
        try:
            stream.flush()
        except OSError:
            empty = os.open(os.devnull, os.O_WRONLY)
            os.dup2(empty, number)  # else Python tries once more at its end, and complains with a traceback
            os.close(empty)
            raise


class Outlet(io.FileIO):
    """A standard stream that drops what nobody reads any more; one for errors drops what cannot be written."""

    def write(self, data) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if self.fileno() == 1 and error.errno not in UNREAD:
                raise OSError(error.errno, error.strerror, "standard output") from None
            return len(memoryview(data).cast("B"))


def _open_missing() -> None:
    """Open those of the first three files that are closed: else a file of ours gets their number, and their text."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # the lowest number that is free


def _wrap(stream: TextIO | None, number: int) -> TextIO:
    encoding = stream.encoding if stream else "utf-8"
    raw = io.BufferedWriter(Outlet(number, "wb", closefd=False))
    lines = number == 2 or os.isatty(number)
    if stream:
        stream.flush()
    return io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=lines)
