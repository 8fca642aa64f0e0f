"""What a viewer shows of runs and studies: in a window, in a browser, or as a picture of its first tab."""

import os
import shlex
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from subprocess import Popen
from tempfile import TemporaryDirectory
from urllib.parse import quote

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from rerun.experimental import ViewerClient

from deepgps.reports.plots import COLOURS
from deepgps.runs.run_folder import is_study
from deepgps.viewer.connect import HOST, find_free_port, has_display, send_file, start_viewer, url_of, wait_for_port
from deepgps.viewer.pair import CHANGE_COLOURS, write_pair
from deepgps.viewer.run import find_recording, lacks_truth
from deepgps.viewer.study import find_study
from sim.errors import InputError, WorkError
from sim.files.atomic import write_bytes

SIZE_PX = "1600x1000"
MARK = ("Software", "deepgps view --screenshot")
DRIVER_HINT = "--screenshot needs a Vulkan driver, such as Mesa's: apt-get install mesa-vulkan-drivers"
PATIENCE_S, POLL_S = 600.0, 0.5
SHOWN_SHARE = 0.6  # Share of a colour scale that a picture shows once its error field is drawn


def view(paths: Sequence[Path]) -> None:
    """Open the folders of ``find_shown`` in a window and wait until it is closed; raises as it does, or WorkError."""
    recording = find_shown(paths)
    fix = (
        f"without a display, copy {recording} to a machine that has one, or run: "
        f"deepgps view {shlex.join(map(str, paths))} --web"
    )
    if not has_display():
        raise WorkError(f"the Rerun viewer cannot open a window; {fix}")
    # At the port of another viewer, it would hand over the recording without opening a window.
    with start_viewer(find_free_port(), [str(recording)], fix) as viewer:
        viewer.wait()


def serve(paths: Sequence[Path], ports: tuple[int, int], say: Callable[[str], None]) -> None:
    """Serve the folders of ``find_shown`` to a browser until this process is interrupted, by Ctrl-C or by SIGTERM.

    The ports are those of the page and of its data; ``say`` is called with the address once it can be opened. Raises as
    ``find_shown`` does, or WorkError if the viewer is missing or cannot serve.
    """
    page, data = ports
    recording, words = find_shown(paths), ["--serve-web", "--web-viewer-port", str(page)]
    with start_viewer(data, words, "deepgps view without --web opens a window") as viewer:
        for port in ports:
            wait_for_port(port, viewer)
        if viewer.poll() is None:
            send_file(recording, url_of(data))
            say(f"open http://{HOST}:{page}/?url={quote(url_of(data), safe='')}\npress Ctrl-C to stop")
            viewer.wait()


def write_screenshot(paths: Sequence[Path], out: Path) -> None:
    """Write as PNG the first tab of what shows these folders, once its error field is drawn.

    Raises as ``find_shown`` does, InputError for a run without truth, and WorkError if the viewer is missing, has no
    Vulkan driver, or draws no error field in time.
    """
    for folder in paths:
        if not is_study(folder) and lacks_truth(folder):
            raise InputError(f"{folder}: its recording has no truth, so there is no error field to take a picture of")
    recording, port = find_shown(paths), find_free_port()
    words = ["--headless", "--hide-welcome-screen", "--window-size", SIZE_PX]
    with start_viewer(port, words, DRIVER_HINT) as viewer, TemporaryDirectory(prefix="deepgps-") as folder:
        wait_for_port(port, viewer)
        send_file(recording, url_of(port))
        picture = _take_when_drawn(viewer, url_of(port), Path(folder) / "screenshot.png")
    if picture is not None:
        mark, buffer = PngInfo(), BytesIO()
        mark.add_text(*MARK)
        picture.save(buffer, "png", pnginfo=mark)
        write_bytes(out, buffer.getvalue())


def is_screenshot(data: bytes) -> bool:
    """Whether these are the contents of a picture that ``write_screenshot`` wrote."""
    return data.startswith(b"\x89PNG") and "\0".join(MARK).encode() in data[:500]


def find_shown(paths: Sequence[Path]) -> Path:
    """The recording that shows one run, one study, or two runs together; it is written if it is missing.

    Raises InputError if a folder is no run and no finished study, its recording is truncated, or two do not compare.
    """
    if len(paths) != 1:
        return write_pair(paths)
    return find_study(paths[0]) if is_study(paths[0]) else find_recording(paths[0])


def choose_ports(page: int | None) -> tuple[int, int]:
    """Ports of the page and of its data: ``page`` and the next port, or free ones; raises InputError."""
    if page is None:
        return find_free_port(), find_free_port()
    if not 1 <= page <= 65534:
        raise InputError(f"--port {page}: must be between 1 and 65534, since the next port serves the data")
    for port in (page, page + 1):
        try:
            socket.create_server((HOST, port)).close()
        except OSError as error:
            reason = os.strerror(error.errno or 0)
            raise InputError(
                f"--port {page}: port {port} is not available ({reason}); without --port, a free one is chosen"
            ) from None
    return page, page + 1


def shows_scale(picture: np.ndarray) -> bool:
    """Whether a picture (rows, columns, 3) has most colours of the scale of errors, or of that of their changes."""
    there = {tuple(colour) for colour in np.unique(picture.reshape(-1, 3) // 8, axis=0)}
    for colours in (COLOURS, CHANGE_COLOURS):
        wanted = (255 * colours(np.linspace(0, 1, 40))[:, :3]).astype(int) // 8
        if np.mean([tuple(colour) in there for colour in wanted]) > SHOWN_SHARE:
            return True
    return False


def _take_when_drawn(viewer: Popen, url: str, path: Path) -> Image.Image | None:
    """Take a viewer's pictures until one shows a colour scale and is the same as the one before; None if it has ended.

    A picture that takes longer than Rerun's client waits is there a little later.
    """
    end, client, before = time.monotonic() + PATIENCE_S, ViewerClient.connect(url), b""
    while viewer.poll() is None:
        with suppress(RuntimeError, OSError):
            client.save_screenshot(str(path))
        with suppress(OSError):
            picture = Image.open(path).convert("RGB")
            if picture.tobytes() == before and shows_scale(np.asarray(picture)):
                return picture
            before = picture.tobytes()
        if time.monotonic() > end:
            raise WorkError(f"the Rerun viewer drew no error field within {PATIENCE_S:.0f} s")
        time.sleep(POLL_S)
    return None
