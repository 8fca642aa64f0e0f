"""A Chromium without a window, controlled through its DevTools pipe: JSON between zero bytes."""

import base64
import fcntl
import json
import os
import select
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import IO, Any

from sim.errors import WorkError

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# WebGL on the processor, for machines without a graphics card.
SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")

ANSWER_S = 300.0
"""Time after which Chromium hangs, if it sends nothing [s]; a busy processor draws a picture in a minute."""

# It reads from 3 and writes to 4.
START = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
)

Picture = Callable[[], bytes]


def find_chromium() -> str | None:
    """Path of a Chromium on this machine."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@contextmanager
def open_page(url: str, profile: Path, width_px: int = 1600, height_px: int = 900) -> Iterator[Picture]:
    """Open a page in the dark theme; yields a function that takes its picture as PNG, empty where there is none yet.

    Args:
        url: The page's address.
        profile: An empty folder for Chromium's own files.
        width_px: Width of the page.
        height_px: Height of the page.

    Raises:
        WorkError: There is no Chromium, or it ends or hangs, also while a picture is taken.
    """
    chromium = find_chromium()
    if chromium is None:
        raise WorkError(f"there is no Chromium: no command {', '.join(NAMES)}")
    read_here, write_there = os.pipe()
    read_there, write_here = os.pipe()
    theirs = [_move_up(end) for end in (read_there, write_there)]
    flags = [*SOFTWARE, "--headless=new", "--no-first-run", "--remote-debugging-pipe", f"--user-data-dir={profile}"]
    if os.geteuid() == 0:
        flags.append("--no-sandbox")  # Chromium has none for root
    command = [sys.executable, "-c", START, *map(str, theirs), chromium, *flags, "about:blank"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, pass_fds=theirs, stdout=quiet, stderr=quiet) as process:
        for end in theirs:
            os.close(end)
        # unbuffered, so that a read returns what is there
        with os.fdopen(write_here, "wb", buffering=0) as out, os.fdopen(read_here, "rb", buffering=0) as answers:
            numbers, messages = count(1), _read_messages(answers)

            def tell(method: str, session: str | None = None, **values: Any) -> dict[str, Any]:
                number = next(numbers)
                message = {"id": number, "method": method, "params": values}
                try:
                    out.write(json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0")
                    answer = next(one for one in map(json.loads, messages) if one.get("id") == number)
                except (EOFError, TimeoutError, BrokenPipeError) as error:
                    why = f"hangs: no answer in {ANSWER_S:g} s" if isinstance(error, TimeoutError) else "has ended"
                    raise WorkError(
                        f"Chromium {why}; {shlex.quote(chromium)} --headless=new --screenshot about:blank may say why, "
                        "and deepgps view --web shows the same in a browser of your own"
                    ) from None
                return answer.get("result", {})

            try:
                target = tell("Target.createTarget", url="about:blank")["targetId"]
                page = tell("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
                size = {"width": width_px, "height": height_px}
                tell("Emulation.setDeviceMetricsOverride", page, **size, deviceScaleFactor=1, mobile=False)
                dark = [{"name": "prefers-color-scheme", "value": "dark"}]
                tell("Emulation.setEmulatedMedia", page, features=dark)
                tell("Page.navigate", page, url=url)
                # a page that is still busy with loading has no picture
                yield lambda: base64.b64decode(tell("Page.captureScreenshot", page, format="png").get("data", ""))
            finally:
                process.kill()


def _move_up(end: int) -> int:
    """Return the same pipe under a number that Chromium does not use."""
    moved = fcntl.fcntl(end, fcntl.F_DUPFD, 10)
    os.close(end)
    return moved


def _read_messages(answers: IO[bytes]) -> Iterator[bytes]:
    """Messages as they come; raises TimeoutError where none comes for long, and EOFError at the end."""
    held = b""
    while True:
        while b"\0" not in held:
            if not select.select([answers], [], [], ANSWER_S)[0]:
                raise TimeoutError
            if not (part := answers.read(1 << 16)):
                raise EOFError
            held += part
        message, _, held = held.partition(b"\0")
        yield message
