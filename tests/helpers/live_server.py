"""A real viewer server without a window, for tests of what streams to one."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from deepgps.viewer.connect import HOST, find_free_port, find_viewer, wait_for_port


@contextmanager
def serve_grpc(*words: str) -> Iterator[tuple[str, subprocess.Popen]]:
    """Address and process of ``rerun`` with these words; ended when left."""
    port = find_free_port()
    command = [find_viewer(), *words, "--bind", HOST, "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            wait_for_port(port, server)
            yield f"{HOST}:{port}", server
        finally:
            server.kill()
