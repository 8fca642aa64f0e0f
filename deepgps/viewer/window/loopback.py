"""A server of a few files for this machine alone, which no external page can read.

It listens at 127.0.0.1 and answers only requests that name this host, so a page whose foreign host name was redirected
to this machine (DNS rebinding) gets nothing. It serves no folder, only the given names.
"""

import logging
import os
import shutil
import socket
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from deepgps.viewer.window.connect import HOST
from sim.errors import one_line

NAMES = (HOST, "localhost")
TIMEOUT_S = 60.0
"""How long a connection may be idle."""


@dataclass(frozen=True)
class Served:
    """What is served under one name.

    Attributes:
        kind: The Content-Type.
        source: The file or its bytes.
    """

    kind: str
    source: Path | bytes


@contextmanager
def serve_files(
    port: int, files: Mapping[str, Served], readers: tuple[int, ...] = (), headers: Mapping[str, str] | None = None
) -> Iterator[None]:
    """Serve files while this is entered.

    Args:
        port: Port to listen at.
        files: Files by their path in the URL, such as ``/index.html``.
        readers: Ports of this machine whose pages may also read the files.
        headers: Headers sent with every file.

    Raises:
        OSError: The port is not available.
    """

    origins = frozenset(f"http://{host}" for reader in readers for host in _name_hosts(reader))
    site = _Site(_name_hosts(port), origins, files, headers or {})
    with _Server(port, site) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()


@dataclass(frozen=True)
class _Site:
    """What a server serves, the host names that requests must use, and the origins of pages that may read it."""

    hosts: frozenset[str]
    origins: frozenset[str]
    files: Mapping[str, Served]
    headers: Mapping[str, str]


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, port: int, site: _Site) -> None:
        self.site = site
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: socket.socket | tuple[bytes, socket.socket], client_address: object) -> None:
        """Log the error in one line, unless the browser closed the connection."""
        error = sys.exception()
        if error is not None and not isinstance(error, OSError):
            logging.getLogger(__name__).warning("a request failed (%s: %s)", type(error).__name__, one_line(error))


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = TIMEOUT_S

    @property
    def site(self) -> _Site:
        """The site that is served."""
        assert isinstance(self.server, _Server)
        return self.server.site

    def do_GET(self) -> None:
        """Send a file."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """Send the headers of a file."""
        self._answer(body=False)

    def version_string(self) -> str:
        """The name of the server."""
        return "deepgps"

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""

    def _answer(self, body: bool) -> None:
        found = self.site.files.get(self.path.partition("?")[0])
        if self.headers.get_all("Host") not in [[host] for host in self.site.hosts]:
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
        elif found is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif isinstance(found.source, bytes):
            self._send_head(found.kind, len(found.source))
            if body:
                self.wfile.write(found.source)
        else:
            with found.source.open("rb") as file:
                self._send_head(found.kind, os.fstat(file.fileno()).st_size)
                if body:
                    shutil.copyfileobj(file, self.wfile, 1 << 20)

    def _send_head(self, kind: str, size: int) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        if self.headers.get("Origin") in self.site.origins:
            self.send_header("Access-Control-Allow-Origin", self.headers["Origin"])
        for name, value in self.site.headers.items():
            self.send_header(name, value)
        self.end_headers()


def _name_hosts(port: int) -> frozenset[str]:
    """Values of the Host header by which a browser on this machine may address this server."""
    return frozenset(name if port == 80 else f"{name}:{port}" for name in NAMES)
