"""The Rerun viewer's program: starting it for this machine alone, and finding one that runs."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

import rerun as rr

from sim.errors import InputError, WorkError, one_line

HOST = "127.0.0.1"  # everything that listens here is for this machine alone
ANSWER_S = 1.5
LOST_VIEWER_ERRORS = (RuntimeError, ConnectionError)  # Errors that rerun raises when no viewer answers
OPENING_S, SENDING_S = 60.0, 600.0
NO_WINDOW = "the Rerun viewer cannot open a window; without a display, --live HOST:PORT streams to a viewer elsewhere"


def connect(address: str, application: str, batching: rr.ChunkBatcherConfig | None = None) -> rr.RecordingStream:
    """A stream to the viewer at ``host:port`` or a Rerun URL, or to one that is opened, which stays open.

    Raises InputError if no viewer answers, WorkError if none can be opened.
    """
    url = address if "://" in address else f"rerun+http://{address}/proxy" if address else open_viewer()
    stream = rr.RecordingStream(application, send_properties=False, batcher_config=batching)
    try:
        stream.connect_grpc(url)
        for _ in range(5):
            stream.flush(timeout_sec=ANSWER_S)
            time.sleep(0.1)  # what answers may be no viewer, and its refusal takes a moment to arrive
    except LOST_VIEWER_ERRORS as error:
        rr.unregister_shutdown()  # when the process exits, it would wait for the viewer
        raise InputError(
            f"--live {address}: no Rerun viewer answers there ({one_line(error)}); start one: rerun"
        ) from None
    return stream


def find_viewer() -> str:
    """Path of the viewer that came with rerun-sdk, or of another one; raises WorkError."""
    own = Path(rr.__file__).parents[1] / "rerun_cli"  # the command ``rerun`` only starts this one
    viewer = shutil.which("rerun", path=os.pathsep.join([str(own), os.environ.get("PATH", "")]))
    if viewer is None:
        raise WorkError("the Rerun viewer is missing: there is no command rerun; pip install rerun-sdk installs it")
    return viewer


def has_display() -> bool:
    """Whether a window can be opened here, as far as the environment tells; only Linux tells."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    return sys.platform != "linux" or any(os.environ.get(name) for name in names)


def url_of(port: int) -> str:
    """URL of a viewer at a port of this machine."""
    return f"rerun+http://{HOST}:{port}/proxy"


@contextmanager
def start_viewer(port: int, words: Sequence[str], fix: str) -> Iterator[subprocess.Popen]:
    """Run the viewer with these options while this is entered, listening for data at a port of this machine.

    Raises WorkError, with what helps as its end, if it is missing or has ended with an error when this is left.
    """
    command = [find_viewer(), "--bind", HOST, "--port", str(port), *words]
    quiet = {**os.environ, "RUST_LOG": "error", "NO_COLOR": "1"}
    with TemporaryFile("w+", errors="replace") as said:
        viewer = subprocess.Popen(command, stdout=said, stderr=said, env=quiet, start_new_session=True)
        try:
            yield viewer
        except (WorkError, OSError, RuntimeError):  # Rerun raises the latter two where the viewer ends in between
            with suppress(subprocess.TimeoutExpired):
                viewer.wait(1.0)  # where it ends by itself, its own reason says more
            if not viewer.poll():
                raise
        finally:
            failed = bool(viewer.poll())
            viewer.terminate()
            viewer.wait()
        if failed:
            said.seek(0)
            lines = [line.strip() for line in said if line.strip()] or ["no reason given"]
            reason = next((line for line in lines if "Error" in line or "panicked" in line), lines[-1])
            raise WorkError(f"the Rerun viewer exited with code {viewer.returncode} ({reason}); {fix}")


def send_file(recording: Path, url: str) -> None:
    """Send a recording to a viewer; raise WorkError if it does not take it.

    One that is given the file itself loads it bit by bit, or keeps a core busy without end.
    """
    stream = rr.RecordingStream("deepgps", send_properties=False)
    try:
        stream.connect_grpc(url)
        stream.log_file_from_path(recording)
        stream.flush(timeout_sec=SENDING_S)
        stream.disconnect()
    except (RuntimeError, OSError) as error:
        raise WorkError(f"the Rerun viewer did not take {recording} ({one_line(error)})") from None


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
    return url_of(port)


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
