"""Recordings in a browser: the viewer's page and its data, served to this machine alone."""

import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from deepgps.viewer.window.connect import HOST, find_free_port
from deepgps.viewer.window.loopback import Served, serve_files
from deepgps.viewer.window.page import take_page
from deepgps.viewer.window.show import find_shown
from sim.errors import InputError

RECORDING = "/recording.rrd"


def serve(paths: Sequence[Path], ports: tuple[int, int], say: Callable[[str], None]) -> None:
    """Serve a run, a study or two runs to a browser until this process is interrupted, by Ctrl-C or by SIGTERM.

    Args:
        paths: As in ``find_shown``.
        ports: Ports of the page and of its data.
        say: Called with the address once it can be opened.

    Raises:
        InputError: As in ``find_shown``.
        WorkError: The viewer is missing or has no page.
    """
    with serve_recording(find_shown(paths), ports) as address:
        say(f"open {address}\npress Ctrl-C to stop")
        threading.Event().wait()


@contextmanager
def serve_recording(path: Path, ports: tuple[int, int]) -> Iterator[str]:
    """Serve a recording and the viewer's page while this is entered; yields the address to open."""
    page, data = ports
    recording = Served("application/octet-stream", path)
    with (
        serve_files(page, take_page(), headers={"Content-Security-Policy": _allow(data)}),
        serve_files(data, {RECORDING: recording}, readers=(page,)),
    ):
        source = quote(f"http://{HOST}:{data}{RECORDING}", safe="")
        yield f"http://{HOST}:{page}/?url={source}"


def _allow(data: int) -> str:
    """What the page may load: itself and its data, but nothing external such as the fonts that Rerun's page names."""
    sources = {
        "default-src": "'self' data: blob:",
        "script-src": "'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:",
        "style-src": "'self' 'unsafe-inline'",
        "connect-src": f"'self' http://{HOST}:{data}",
        "frame-ancestors": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in sources.items())


def choose_ports(page: int | None) -> tuple[int, int]:
    """Ports of the page and of its data: ``page`` and the next port, or free ones; raises InputError."""
    if page is None:
        return find_free_port(), find_free_port()
    if not 1 <= page <= 65534:
        raise InputError(f"--port {page}: must be between 1 and 65534, since the next port serves the data")
    for port in (page, page + 1):
        try:
            with socket.socket() as listener:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind((HOST, port))
        except OSError as error:
            raise InputError(
                f"--port {page}: port {port} is not available ({error.strerror}); without --port, a free one is chosen"
            ) from None
    return page, page + 1
