"""A run's recording in a browser: the viewer's page and its data, served to this machine alone."""

import os
import signal
import socket
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from urllib.parse import quote

from deepgps.viewer.connect import HOST, find_free_port, find_viewer, wait_for_port
from deepgps.viewer.show import find_shown
from sim.errors import InputError, WorkError


def serve(paths: Sequence[Path], ports: tuple[int, int], say: Callable[[str], None]) -> None:
    """Serve a run, a study or two runs to a browser until this process is interrupted, by Ctrl-C or by SIGTERM.

    Args:
        paths: As of ``find_shown``.
        ports: Of the page, and of its data.
        say: Told the address once it can be opened.

    Raises:
        InputError: As of ``find_shown``.
        WorkError: The viewer is missing, or ended.
    """
    recording = find_shown(paths)
    page, data = ports
    command = [find_viewer(), "--serve-web", "--bind", HOST, "--web-viewer-port", str(page), "--port", str(data)]
    for ending in (signal.SIGTERM, signal.SIGHUP):  # else the server would outlive this process
        signal.signal(ending, signal.default_int_handler)
    with TemporaryFile("w+") as told:
        # Its own words, of which an error is the last line, are few enough for a file.
        quiet = {**os.environ, "RUST_LOG": "error", "NO_COLOR": "1"}
        server = subprocess.Popen(
            [*command, str(recording)], stdout=told, stderr=told, env=quiet, start_new_session=True
        )
        try:
            wait_for_port(data, server)
            wait_for_port(page, server)
            if server.poll() is None:
                source = quote(f"rerun+http://{HOST}:{data}/proxy", safe="")
                say(f"open http://{HOST}:{page}/?url={source}\nCtrl-C ends it")
            server.wait()
            told.seek(0)
            reason = ([line for line in told if line.strip()] or ["no reason given"])[-1].strip()
            raise WorkError(f"the Rerun viewer's server ended with {server.returncode} ({reason})")
        finally:
            with suppress(ProcessLookupError):  # it has ended
                os.killpg(server.pid, signal.SIGTERM)  # both: rerun is a script that starts the server
            server.wait()


def choose_ports(page: int | None) -> tuple[int, int]:
    """Ports of the page and of its data: the one wanted and the next, or free ones; raises InputError."""
    if page is None:
        return find_free_port(), find_free_port()
    if not 1 <= page <= 65534:
        raise InputError(f"--port {page}: must be between 1 and 65534, since the data comes from the next one")
    for port in (page, page + 1):
        try:
            with socket.socket() as listener:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind((HOST, port))
        except OSError as error:
            raise InputError(
                f"--port {page}: port {port} cannot be had ({error.strerror}); without --port a free one is taken"
            ) from None
    return page, page + 1
