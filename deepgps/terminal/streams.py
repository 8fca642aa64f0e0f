"""Standard streams that are always open and accept any text, even if nobody reads them."""

import errno
import io
import os
import sys
from contextlib import suppress
from typing import TextIO

CLOSED_OUTPUT_ERRORS = (errno.EPIPE, errno.EIO)  # a pipe that is closed at its other end, a terminal that is gone


def open_streams() -> None:
    """Replace this process's standard output and error by such streams; a closed one becomes ``/dev/null``.

    Characters that the encoding lacks are written as escapes. Output that nobody reads any more is dropped, and the
    work continues.
    """
    _open_missing()
    if sys.stdin is None:  # it was closed, and is /dev/null now
        sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
    sys.stdout = _wrap(sys.stdout, 1)
    sys.stderr = _wrap(sys.stderr, 2)


def flush_streams() -> None:
    """Write buffered output; if that fails, discard it and raise OSError."""
    for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
        try:
            stream.flush()
        except OSError:
            empty = os.open(os.devnull, os.O_WRONLY)
            os.dup2(empty, number)  # else Python tries again at exit, and fails with a traceback
            os.close(empty)
            raise


class Outlet(io.FileIO):
    """A standard stream that drops output that nobody reads any more; standard error drops all it cannot write."""

    def write(self, data) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if self.fileno() == 1 and error.errno not in CLOSED_OUTPUT_ERRORS:
                raise OSError(error.errno, error.strerror, "standard output") from None
            return len(memoryview(data).cast("B"))


def _open_missing() -> None:
    """Open those of the first three file descriptors that are closed: else another file gets their number and text."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # gets the lowest free number


def _wrap(stream: TextIO | None, number: int) -> TextIO:
    encoding = stream.encoding if stream else "utf-8"
    raw = io.BufferedWriter(Outlet(number, "wb", closefd=False))
    lines = number == 2 or os.isatty(number)
    if stream:
        stream.flush()
    return io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=lines)
