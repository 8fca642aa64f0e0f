"""The files of Rerun's web viewer, which are embedded in its program and come from the program's own server."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException
from tempfile import TemporaryFile

from deepgps.viewer.window.connect import HOST, end_group, find_free_port, find_viewer, wait_for_port
from deepgps.viewer.window.loopback import Served
from sim.errors import WorkError

KINDS = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
    "/sw.js": "text/javascript",
}
ANSWER_S = 60.0


def take_page() -> dict[str, Served]:
    """Return the viewer's files by their path in the URL; raise WorkError if the viewer or one of them is missing."""
    port = find_free_port()
    with _serve_page(port):
        connection = HTTPConnection(HOST, port, timeout=ANSWER_S)
        try:
            return {path: _take(connection, path, kind) for path, kind in KINDS.items()}
        except (OSError, HTTPException) as error:
            raise WorkError(f"the Rerun viewer does not serve its web page ({error})") from None
        finally:
            connection.close()


def _take(connection: HTTPConnection, path: str, kind: str) -> Served:
    connection.request("GET", path)
    answer = connection.getresponse()
    data = answer.read()
    if answer.status != 200:
        raise WorkError(f"the Rerun viewer has no {path} ({answer.status}); pip install -U rerun-sdk may add it")
    return Served(kind, data)


@contextmanager
def _serve_page(port: int) -> Iterator[None]:
    """Run Rerun's own server, but only while this is entered, since it answers requests for any host name."""
    command = [find_viewer(), "--serve-web", "--bind", HOST, "--web-viewer-port", str(port)]
    quiet = {**os.environ, "RUST_LOG": "error", "NO_COLOR": "1"}
    with TemporaryFile("w+", errors="replace") as output:  # short; an error is its last line
        server = subprocess.Popen(
            [*command, "--port", str(find_free_port())], stdout=output, stderr=output, env=quiet, start_new_session=True
        )
        try:
            wait_for_port(port, server)
            if server.poll() is not None:
                output.seek(0)
                reason = ([line for line in output if line.strip()] or ["no reason given"])[-1].strip()
                raise WorkError(f"the Rerun viewer's server exited with code {server.returncode} ({reason})")
            yield
        finally:
            end_group(server)
            server.wait()
