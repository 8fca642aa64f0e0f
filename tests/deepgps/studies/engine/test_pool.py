"""Worker processes: all tasks are done, each failure is named, and one that is killed fails its task alone."""

import os
import signal
from dataclasses import dataclass
from multiprocessing import active_children
from pathlib import Path

import pytest

from deepgps.studies.engine.pool import KILL_NOTE, Tell, do_all
from sim.errors import WorkError


@dataclass(frozen=True)
class Work:
    """A task that ends as its name says, and leaves a file if it is done."""

    how: str
    folder: Path
    size: int = 4

    def __call__(self, tell: Tell) -> str | None:
        tell(1)
        if self.how == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.how == "wrong":
            raise WorkError("it did not\nwant to")
        if self.how == "bug":
            raise KeyError("nowhere")
        tell(9)
        (self.folder / self.how).write_text(os.environ.get("OMP_NUM_THREADS", ""))
        return "said no" if self.how == "no" else None


def test_each_task_is_done_or_named_with_its_reason_and_progress_is_the_sum(tmp_path: Path):
    told: list[int] = []
    names = ("one", "killed", "wrong", "bug", "no", "other")
    failed = do_all({name: Work(name, tmp_path) for name in names}, 2, told.append)
    assert failed == {
        **{"killed": KILL_NOTE, "wrong": "it did not want to"},
        **{"bug": "KeyError: 'nowhere'", "no": "said no"},
    }
    assert {path.name for path in tmp_path.iterdir()} == {"one", "no", "other"}
    assert told[-1] <= 4 * len(names)
    assert not active_children()


def test_nothing_to_do_starts_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("deepgps.studies.engine.pool.ProcessPoolExecutor", None)
    assert do_all({}, 2, lambda done: None) == {}


def test_an_interrupt_ends_all_processes_at_once(tmp_path: Path):
    def interrupt(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        do_all({name: Work(name, tmp_path) for name in "abcdefgh"}, 2, interrupt)
    assert not active_children()
