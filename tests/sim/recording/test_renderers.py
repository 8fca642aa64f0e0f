"""Workers that draw: replaced where they die, hang or err, within limits; and none is left behind."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim.errors import WorkError
from sim.recording import renderers
from sim.recording.renderers import Part, Renderers, UnsteadyError

Beat = Callable[[], None]


def write_name(part: Part, beat: Beat) -> None:
    beat()
    part.path.write_text(part.path.name)


def always_die(part: Part, beat: Beat) -> None:
    os.abort()


def always_hang(part: Part, beat: Beat) -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


def always_differ(part: Part, beat: Beat) -> None:
    raise UnsteadyError(f"{part.path}: image 0 of 1 was drawn twice and came out different")


def die_and_differ_once(part: Part, beat: Beat) -> None:
    """Crash on one part and err on another, the first time each is drawn."""
    once = part.path.with_name(f"once-{part.path.name}")
    if part.path.name in {"1", "3"} and not once.exists():
        once.touch()
        if part.path.name == "1":
            os.abort()
        raise UnsteadyError(f"{part.path}: image 0 of 1 was drawn twice and came out different")
    part.path.write_text(f"differed {part.differed}")


def fill_disk(part: Part, beat: Beat) -> None:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(part.path))


def take_long(part: Part, beat: Beat) -> None:
    for _ in range(50):
        time.sleep(0.2)
        beat()


def wait_for_go(part: Part, beat: Beat) -> None:
    end = time.monotonic() + 10.0
    while not (go := part.path.with_name("go").exists()) and time.monotonic() < end:
        time.sleep(0.05)
        beat()
    if not go:
        raise WorkError("the parent waits for this part")
    part.path.write_text(part.path.name)


def draw_all(draw, settings, folder: Path, count: int = 5) -> Renderers:
    with Renderers(draw, 2, 0.0) as workers:
        for number in range(count):
            workers.give(Part(settings, np.zeros((1, 9)), folder / f"{number}"))
        workers.finish(lambda _: None)
    return workers


def test_every_part_is_drawn_once(small_settings, tmp_path):
    workers = draw_all(write_name, small_settings, tmp_path, 7)
    assert (workers.drawn, workers.deaths) == (7, 0)
    assert sorted(path.read_text() for path in tmp_path.iterdir()) == [str(number) for number in range(7)]


def test_a_worker_that_dies_or_errs_once_is_replaced_and_every_part_is_drawn(small_settings, tmp_path, caplog):
    workers = draw_all(die_and_differ_once, small_settings, tmp_path)
    assert (workers.drawn, workers.deaths) == (5, 1)
    differed = [int((tmp_path / f"{number}").read_text()[-1]) for number in range(5)]
    assert differed == [0, 0, 0, 1, 0]
    assert "a rendering process died" in caplog.text and "the file is drawn again" in caplog.text


def test_a_large_part_is_given_without_waiting_for_the_one_that_is_drawn(small_settings, tmp_path):
    with Renderers(wait_for_go, 1, 0.0) as workers:
        for number in range(2):
            workers.give(Part(small_settings, np.zeros((50_000, 9)), tmp_path / f"{number}"))
        (tmp_path / "go").touch()
        workers.finish(lambda _: None)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "1", "go"]


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (always_die, "a rendering process died; deepgps doctor checks the renderer"),
        (always_hang, "a rendering process gave no sign of life for 4 s; deepgps doctor checks the renderer"),
        (always_differ, "came out different, 3 times; deepgps doctor checks the renderer"),
    ],
)
def test_renderers_that_never_work_are_given_up(draw, message, small_settings, tmp_path, monkeypatch):
    monkeypatch.setattr(renderers, "MIN_SILENCE_S", 2.0 if draw is always_hang else 20.0)
    monkeypatch.setattr(renderers, "SILENCE_FACTOR", 0.0)
    monkeypatch.setattr(renderers, "MAX_DEATHS", 1)
    with pytest.raises(WorkError, match=message):
        draw_all(draw, small_settings, tmp_path, 2)


@pytest.mark.slow
def test_one_that_gives_signs_of_life_may_take_as_long_as_it_needs(small_settings, tmp_path, monkeypatch):
    monkeypatch.setattr(renderers, "MIN_SILENCE_S", 8.0)
    monkeypatch.setattr(renderers, "SILENCE_FACTOR", 0.0)
    assert draw_all(take_long, small_settings, tmp_path, 1).deaths == 0


def test_patience_grows_with_the_scene():
    assert Renderers(write_name, 1, 60.0).limit_s() > 10 * Renderers(write_name, 1, 0.1).limit_s()


def test_an_error_in_a_worker_keeps_its_kind_and_its_path(small_settings, tmp_path):
    with pytest.raises(OSError, match=str(tmp_path)) as caught:
        draw_all(fill_disk, small_settings, tmp_path)
    assert caught.value.errno == errno.EROFS


PARENT = """
import sys, time
from pathlib import Path
import numpy as np
from tests.conftest import SMALL_WORLD
from sim.recording.renderers import Part, Renderers
from tests.sim.recording.test_renderers import always_hang
if __name__ == "__main__":
    with Renderers(always_hang, 2, 0.0) as workers:
        for number in range(2):
            workers.give(Part(SMALL_WORLD, np.zeros((1, 9)), Path(str(number))))
        while len(workers._processes) < 2:
            time.sleep(0.05)
        print(*[process.pid for process in workers._processes], flush=True)
        time.sleep(60)
"""


def state(pid: int) -> str:
    """State of a process, as ``T`` for stopped; nothing where there is none, or only its entry is left."""
    try:
        letter = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""
    return letter.replace("Z", "").replace("X", "")


def wait_for(states: list[str], pids: list[int], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if [state(pid) for pid in pids] == states:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's own way is Linux's")
def test_no_worker_outlives_its_parent_not_even_a_stopped_one(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    paths = os.pathsep.join([str(Path(__file__).parents[3]), *sys.path])
    command = [sys.executable, str(script)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": paths}
    ) as parent:
        assert parent.stdout is not None
        pids = [int(word) for word in parent.stdout.readline().split()]
        try:
            assert len(pids) == 2 and wait_for(["T", "T"], pids, 20.0)
        finally:
            parent.kill()
        assert wait_for(["", ""], pids, 2.0)
