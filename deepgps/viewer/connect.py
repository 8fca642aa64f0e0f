"""Where a viewer listens: its address, a free port, a viewer of our own."""

import os
import shutil
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

from sim.errors import InputError, WorkError

HOST = "127.0.0.1"  # what is served here, and what listens here, is for this machine alone
ANSWER_S = 3.0
OPENING_S = 60.0


def find_url(address: str) -> str:
    """URL of the viewer that answers at ``host:port``, or at a URL of Rerun's kind; raises InputError."""
    url = address if "://" in address else f"rerun+http://{address}/proxy"
    parts = urlsplit(url)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:  # no number, or too large
        host, port = None, None
    if not host or not port or parts.scheme not in {"rerun", "rerun+http", "rerun+https"} or parts.path != "/proxy":
        raise InputError(f"--live {address!r}: must be host:port, as {HOST}:9876, or rerun+http://host:port/proxy")
    try:
        socket.create_connection((host, port), ANSWER_S).close()
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise InputError(f"--live {address}: no viewer answers there ({reason}); one listens after: rerun") from None
    return url


def find_viewer() -> str:
    """Path of the viewer that came with rerun-sdk, whether or not its environment is active; raises WorkError."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    viewer = shutil.which("rerun", path=places)
    if viewer is None:
        raise WorkError("the Rerun viewer is missing: there is no command rerun; pip install rerun-sdk brings it")
    return viewer


def open_viewer() -> str:
    """URL of a viewer that is opened for it, and stays open when this process ends; raises WorkError."""
    port = find_free_port()
    command = [find_viewer(), "--bind", HOST, "--port", str(port), "--expect-data-soon"]
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)  # Ctrl-C is not for it
    wait_for_port(port, viewer)
    with suppress(subprocess.TimeoutExpired):
        viewer.wait(0.5)  # it listens before it tries to open a window
    if viewer.poll() is not None:
        raise WorkError(
            "the Rerun viewer cannot open a window; without a display, --live HOST:PORT streams to a viewer elsewhere"
        )
    return f"rerun+http://{HOST}:{port}/proxy"


def find_free_port() -> int:
    """A port of this machine that nothing listens at."""
    with socket.socket() as listener:
        listener.bind((HOST, 0))
        return listener.getsockname()[1]


def wait_for_port(port: int, process: subprocess.Popen) -> None:
    """Wait until ``process`` listens or has ended; raises WorkError when it does neither."""
    end = time.monotonic() + OPENING_S
    while process.poll() is None:
        with suppress(OSError):
            socket.create_connection((HOST, port), ANSWER_S).close()
            return
        if time.monotonic() > end:
            process.kill()
            raise WorkError(f"the Rerun viewer does not listen after {OPENING_S:.0f} s")
        time.sleep(0.1)
