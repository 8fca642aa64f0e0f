"""A picture of a recording's first tab: from Chromium if there is one, otherwise from the native viewer."""

import shutil
import subprocess
import time
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from deepgps.reports.plots import COLOURS
from deepgps.runs.run_folder import is_study
from deepgps.viewer.pair import CHANGE
from deepgps.viewer.run.recording import lacks_truth
from deepgps.viewer.window.chromium import Picture, find_chromium, open_page
from deepgps.viewer.window.connect import HOST, end_group, find_free_port, find_viewer, has_display
from deepgps.viewer.window.show import find_shown
from deepgps.viewer.window.web import choose_ports, serve_recording
from sim.errors import InputError, WorkError
from sim.files.atomic import write_bytes

SIZE_PX = (1600, 1000)
MARK = ("Software", "deepgps view --screenshot")
PATIENCE_S = 600.0
SETTLED_S, LOOK_S = 4.0, 2.0
SHOWN = 0.6
"""Share of a colour scale that a picture shows once its error field is drawn."""


def write_screenshot(paths: Sequence[Path], out: Path) -> None:
    """Write a picture of the first tab of what shows these folders, once its error field is drawn.

    Args:
        paths: As in ``find_shown``.
        out: The PNG to write.

    Raises:
        InputError: As in ``find_shown``, or a run has no truth.
        WorkError: There is neither Chromium nor a display, or the viewer draws no error field in time.
    """
    for folder in paths:
        if not is_study(folder) and lacks_truth(folder):
            raise InputError(f"{folder}: its recording has no truth, so there is no error field to take a picture of")
    recording = find_shown(paths)
    with TemporaryDirectory(prefix="deepgps-") as folder:
        if find_chromium() is None:
            png = _take_natively(recording, Path(folder) / "screenshot.png")
        else:
            with (
                serve_recording(recording, choose_ports(None)) as address,
                open_page(address, Path(folder), *SIZE_PX) as take_picture,
            ):
                png = _take_when_drawn(take_picture)
    mark, buffer = PngInfo(), BytesIO()
    mark.add_text(*MARK)
    Image.open(BytesIO(png)).convert("RGB").save(buffer, "png", pnginfo=mark)
    write_bytes(out, buffer.getvalue())


def is_screenshot(data: bytes) -> bool:
    """Whether these are the contents of a picture that ``write_screenshot`` wrote."""
    return data.startswith(b"\x89PNG") and "\0".join(MARK).encode() in data[:500]


def _take_when_drawn(take_picture: Picture) -> bytes:
    """Take pictures until one shows a colour scale and has not changed for a while."""
    end, drawn, before, since = time.monotonic() + PATIENCE_S, False, b"", time.monotonic()
    while time.monotonic() < end:
        time.sleep(LOOK_S)
        png = take_picture()
        if png != before:
            before, since = png, time.monotonic()
            drawn = bool(png) and shows_scale(np.asarray(Image.open(BytesIO(png)).convert("RGB")))
        elif drawn and time.monotonic() - since >= SETTLED_S:
            return png
    raise WorkError(f"the viewer in Chromium drew no error field within {PATIENCE_S:.0f} s")


def shows_scale(picture: np.ndarray) -> bool:
    """Whether a picture (rows, columns, 3) has most colours of the scale of errors, or of that of their changes."""
    there = {tuple(colour) for colour in np.unique(picture.reshape(-1, 3) // 8, axis=0)}
    for colours in (COLOURS, CHANGE):
        wanted = (255 * colours(np.linspace(0, 1, 40))[:, :3]).astype(int) // 8
        if np.mean([tuple(colour) in there for colour in wanted]) > SHOWN:
            return True
    return False


def _take_natively(recording: Path, out: Path) -> bytes:
    """Take the native viewer's own screenshot, on a display or on a virtual one."""
    display = has_display()
    virtual = shutil.which("xvfb-run")
    if not display and virtual is None:
        raise WorkError("--screenshot needs Chromium or a display: install chromium, or xvfb and mesa-vulkan-drivers")
    width, height = SIZE_PX
    around = [] if display or virtual is None else [virtual, "-a", "-s", f"-screen 0 {width}x{height}x24"]
    size = ["--window-size", f"{width}x{height}", "--screenshot-to", str(out)]
    command = [*around, find_viewer(), "--bind", HOST, "--port", str(find_free_port()), *size, str(recording)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as viewer:
        try:
            said = viewer.communicate(timeout=PATIENCE_S)[1]
        except subprocess.TimeoutExpired:
            raise WorkError(f"the Rerun viewer took no screenshot within {PATIENCE_S:.0f} s") from None
        finally:
            end_group(viewer)  # the virtual display has processes of its own
    if not out.is_file():
        lines = [line for line in said.splitlines() if line.strip()] or ["no reason given"]
        raise WorkError(
            f"the Rerun viewer took no screenshot ({lines[-1].strip()}); Chromium can take one, if installed"
        )
    return out.read_bytes()
