"""A real Chromium without a window, told what to do through its DevTools pipe: JSON between zero bytes."""

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# WebGL on the processor, for machines without a graphics card.
SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")

Picture = Callable[[], bytes]


def find_chromium() -> str | None:
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@contextmanager
def open_page(url: str, profile: Path, width_px: int = 1600, height_px: int = 900) -> Iterator[Picture]:
    """Open a page in the dark theme; yields a function that takes its picture as PNG.

    Args:
        url: Of the page.
        profile: An empty folder for Chromium's own files.
        width_px: Of the page.
        height_px: Of the page.
    """
    chromium = find_chromium()
    assert chromium
    read_here, write_there = os.pipe()
    read_there, write_here = os.pipe()
    flags = [*SOFTWARE, "--headless=new", "--no-first-run", "--remote-debugging-pipe", f"--user-data-dir={profile}"]
    if os.geteuid() == 0:
        flags.append("--no-sandbox")  # Chromium has none for root
    command = ["sh", "-c", f'exec "$@" 3<&{read_there} 4>&{write_there}', "sh", chromium, *flags, "about:blank"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, pass_fds=(read_there, write_there), stdout=quiet, stderr=quiet) as process:
        os.close(read_there)
        os.close(write_there)
        with os.fdopen(write_here, "wb", buffering=0) as out, os.fdopen(read_here, "rb") as answers:
            numbers = count(1)

            def tell(method: str, session: str | None = None, **values: Any) -> dict[str, Any]:
                number = next(numbers)
                message = {"id": number, "method": method, "params": values}
                out.write(json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0")
                while True:
                    answer = json.loads(_read_message(answers))
                    if answer.get("id") == number:
                        return answer["result"]

            try:
                target = tell("Target.createTarget", url="about:blank")["targetId"]
                page = tell("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
                size = {"width": width_px, "height": height_px}
                tell("Emulation.setDeviceMetricsOverride", page, **size, deviceScaleFactor=1, mobile=False)
                dark = [{"name": "prefers-color-scheme", "value": "dark"}]
                tell("Emulation.setEmulatedMedia", page, features=dark)
                tell("Page.navigate", page, url=url)
                yield lambda: base64.b64decode(tell("Page.captureScreenshot", page, format="png")["data"])
            finally:
                process.kill()


def _read_message(answers: Any) -> bytes:
    message = bytearray()
    while (byte := answers.read(1)) != b"\0":
        if not byte:
            raise EOFError("Chromium has ended")
        message += byte
    return bytes(message)
