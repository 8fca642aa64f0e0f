"""Connecting to a viewer: finding the address of a running one, or opening one at a free port."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from sim.errors import InputError, WorkError

HOST = "127.0.0.1"  # everything that listens here is for this machine alone
ANSWER_S = 1.5
HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
"""The opening of an HTTP/2 client: a fixed text and a settings frame, here empty. The server opens with a frame too."""
OPENING_S = 60.0
NO_WINDOW = "the Rerun viewer cannot open a window; without a display, --live HOST:PORT streams to a viewer elsewhere"


def end_group(process: subprocess.Popen[Any], how: signal.Signals = signal.SIGKILL) -> None:
    """End a process with a group of its own, and all that it has started: ``rerun`` itself starts the viewer."""
    with suppress(ProcessLookupError):  # all have ended
        os.killpg(process.pid, how)


def find_url(address: str) -> str:
    """URL of the viewer that answers at ``host:port`` or at a Rerun URL; raises InputError if none does."""
    url = address if "://" in address else f"rerun+http://{address}/proxy"
    parts = urlsplit(url)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:  # the port is not a number, or too large
        host, port = None, None
    if not host or not port or parts.scheme not in {"rerun", "rerun+http", "rerun+https"} or parts.path != "/proxy":
        raise InputError(f"--live {address!r}: must be host:port, like {HOST}:9876, or rerun+http://host:port/proxy")
    try:
        socket.create_connection((host, port), ANSWER_S).close()
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise InputError(f"--live {address}: no viewer answers there ({reason}); start one with: rerun") from None
    return url


def knock(url: str) -> Literal["viewer", "stranger", "nobody"]:
    """What answers at a viewer's URL: a server that speaks HTTP/2, something else, or nothing within ``ANSWER_S``."""
    parts = urlsplit(url)
    if parts.scheme != "rerun+http":
        return "viewer"  # its connection is encrypted by TLS, which is not checked
    try:
        with socket.create_connection((parts.hostname or "", parts.port or 0), ANSWER_S) as connection:
            connection.sendall(HELLO)
            frame = connection.recv(9)
    except TimeoutError:
        return "nobody"
    except OSError:
        return "stranger"
    return "viewer" if frame[3:4] == HELLO[-6:-5] else "stranger"


def find_viewer() -> str:
    """Path of the viewer that came with rerun-sdk, whether or not its environment is active; raises WorkError."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    viewer = shutil.which("rerun", path=places)
    if viewer is None:
        raise WorkError("the Rerun viewer is missing: there is no command rerun; pip install rerun-sdk installs it")
    return viewer


def has_display() -> bool:
    """Whether a window can be opened here, as far as the environment tells; only Linux tells."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    return sys.platform != "linux" or any(os.environ.get(name) for name in names)


def open_viewer() -> str:
    """Open a viewer that stays open after this process ends, and return its URL; raise WorkError if that fails."""
    viewer_path = find_viewer()
    if not has_display():
        raise WorkError(NO_WINDOW)
    port = find_free_port()
    command = [viewer_path, "--bind", HOST, "--port", str(port), "--expect-data-soon"]
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)  # Ctrl-C does not reach it
    wait_for_port(port, viewer)
    with suppress(subprocess.TimeoutExpired):
        viewer.wait(0.5)  # it listens before it tries to open a window
    if viewer.poll() is not None:
        raise WorkError(NO_WINDOW)
    return f"rerun+http://{HOST}:{port}/proxy"


def find_free_port() -> int:
    """A port of this machine at which nothing listens."""
    with socket.socket() as listener:
        listener.bind((HOST, 0))
        return listener.getsockname()[1]


def wait_for_port(port: int, process: subprocess.Popen) -> None:
    """Wait until ``process`` listens or has ended; raise WorkError if it does neither in time."""
    end = time.monotonic() + OPENING_S
    while process.poll() is None:
        with suppress(OSError):
            socket.create_connection((HOST, port), ANSWER_S).close()
            return
        if time.monotonic() > end:
            process.kill()
            raise WorkError(f"the Rerun viewer did not start to listen within {OPENING_S:.0f} s")
        time.sleep(0.1)
