"""What a viewer shows of runs and studies: in a window, in a browser, or as a picture of a tab."""

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
from typing import Any
from urllib.parse import quote

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from rerun.experimental import ViewerClient

from deepgps.runs.run_folder import VIEWED, is_study
from deepgps.viewer.connect import HOST, find_free_port, has_display, send_file, start_viewer, url_of, wait_for_port
from deepgps.viewer.stream import open_rrd
from sim.errors import InputError, WorkError
from sim.files.atomic import write_bytes
from sim.files.checksums import is_intact

SIZE_PX = "1600x1000"
MARK = ("Software", "deepgps view --screenshot")
DRIVER_HINT = "--screenshot needs a Vulkan driver, such as Mesa's: apt-get install mesa-vulkan-drivers"
PATIENCE_S, POLL_S, STILLNESS_S = 600.0, 0.5, 2.0  # How long a picture must stay as it is [s]


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
            address = f"{HOST}:{page}/?url={quote(url_of(data), safe='')}&theme=dark"  # the colours are made for it
            say(f"open http://{address}\npress Ctrl-C to stop")
            viewer.wait()


def write_screenshot(paths: Sequence[Path], out: Path, tab: str | None) -> None:
    """Write as PNG one tab of what shows these folders, or the first, once it is drawn.

    Raises as ``find_shown`` does, InputError if there is no such tab, and WorkError if the viewer is missing, has no
    Vulkan driver, or does not finish in time.
    """
    recording, port = find_shown(paths), find_free_port()
    words = ["--headless", "--hide-welcome-screen", "--window-size", SIZE_PX]
    with start_viewer(port, words, DRIVER_HINT) as viewer, TemporaryDirectory(prefix="deepgps-") as folder:
        wait_for_port(port, viewer)
        send_file(recording, url_of(port))
        picture = _take_when_drawn(viewer, url_of(port), tab, Path(folder) / "screenshot.png")
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
    if len(paths) == 1 and not is_study(paths[0]) and is_intact(path := paths[0] / VIEWED):
        open_rrd(path)
        return path
    # These import torch and matplotlib, which takes longer than the viewer needs to open.
    from deepgps.viewer.pair import write_pair
    from deepgps.viewer.run import find_recording
    from deepgps.viewer.study import find_study

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


def choose_tab(blueprint: dict[str, Any], tab: str | None) -> None:
    """Bring a tab of a layout to the front, or leave the first there; raise InputError if there is none of the name."""
    tabs = blueprint[f"/container/{blueprint['/viewport']['ViewportBlueprint']['root_container']}"][
        "ContainerBlueprint"
    ]
    names = {_find_name(blueprint[f"/{path}"]): path for path in tabs["contents"]}
    if tab is not None and tab.lower() not in names:
        raise InputError(f"--tab {tab}: there is no such tab; there are {', '.join(names)}")
    tabs["active_tab"] = names[tab.lower()] if tab else tabs["contents"][0]


def _find_name(part: dict[str, Any]) -> str:
    return str({**part.get("ContainerBlueprint", {}), **part.get("ViewBlueprint", {})}.get("display_name")).lower()


def _take_when_drawn(viewer: Popen, url: str, tab: str | None, path: Path) -> Image.Image | None:
    """Choose a tab once the layout is there, and take pictures until one stays for a while; None if the viewer ends.

    A picture that takes longer than Rerun's client waits is there a little later.
    """
    client, before, chosen = ViewerClient.connect(url), b"", False
    end = since = time.monotonic()
    while viewer.poll() is None:
        with suppress(RuntimeError, OSError, KeyError):
            if not chosen:
                layout = client.get_blueprint().blueprint
                choose_tab(layout, tab)
                client.set_blueprint(layout, of="recording")
                chosen = True
            with suppress(ConnectionError):  # a pair of runs has no time
                client.set_time(play_state="following")  # to the end, where all is drawn
            client.save_screenshot(str(path))
        with suppress(OSError):
            picture = Image.open(path).convert("RGB")
            if picture.tobytes() != before:
                before, since = picture.tobytes(), time.monotonic()
            elif chosen and time.monotonic() - since > STILLNESS_S:
                return picture
        if time.monotonic() > end + PATIENCE_S:
            raise WorkError(f"the Rerun viewer did not finish drawing within {PATIENCE_S:.0f} s")
        time.sleep(POLL_S)
    return None
