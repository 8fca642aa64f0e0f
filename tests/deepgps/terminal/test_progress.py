"""Progress where there is no terminal: plain lines, few, and none for long work that is silent."""

import io
import logging
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from deepgps.terminal import console
from deepgps.terminal.progress import Lines, show_progress, write_time


class Clock:
    """A clock that is set."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def run(steps: list[int], total: int, step_s: float = 0.1) -> list[str]:
    """What is said while a label goes through these numbers of steps."""
    said, clock = [], Clock()
    lines = Lines(said.append, clock=clock)
    for done in steps:
        lines("train", done, total)
        clock.now += step_s
    return said


@settings(deadline=None)
@given(total=st.integers(1, 5000), stride=st.integers(1, 700), first=st.integers(0, 50))
def test_first_and_last_are_said_and_about_ten_between(total: int, stride: int, first: int) -> None:
    steps = [*range(min(first, total), total, stride), total]
    said = run(steps, total, step_s=1e-4)
    assert said[0].startswith(f"train: {steps[0]:,} of {total:,}")
    assert said[-1].startswith(f"train: {total:,} of {total:,} (100 %)")
    assert len(said) <= 12
    tenths = {10 * done // total for done in steps}
    assert {10 * int(line.split()[1].replace(",", "")) // total for line in said} == tenths


def test_rate_and_time_left_are_those_of_this_sitting() -> None:
    said = run([400, 500, 1000], 1000, step_s=10.0)
    assert said == [
        "train: 400 of 1,000 (40 %)",
        "train: 500 of 1,000 (50 %), 10/s, 50 s left",
        "train: 1,000 of 1,000 (100 %), 30/s, took 20 s",
    ]


def test_long_work_is_heard_after_four_seconds_and_later_less_often() -> None:
    said = run(list(range(2000)), 100_000, step_s=1.0)
    assert said[1].startswith("train: 4 of 100,000 (0 %), 1/s, 27 h ") and said[2].startswith("train: 8 of 100,000")
    at = [int(line.split()[1].replace(",", "")) for line in said]
    assert all(4 <= later - one <= max(4, 0.03 * later + 1) and later - one <= 60 for one, later in pairwise(at))


def test_a_label_that_begins_again_has_its_time_counted_again() -> None:
    said = run([0, 5, 10, 0, 5, 10], 10, step_s=10.0)
    assert said[:3] == said[3:] == ["train: 0 of 10 (0 %)", "train: 5 of 10 (50 %), 0.5/s, 10 s left", said[2]]


def test_work_without_reports_is_heard_too() -> None:
    said, clock = [], Clock()
    lines = Lines(said.append, clock=clock)
    lines.beat()
    lines("write", 0, 1)
    for _ in range(12):
        clock.now += 1.0
        lines.beat()
    assert said == [
        "write: 0 of 1 (0 %)",
        *(f"write: 0 of 1 (0 %), still at work after {time} s" for time in (4, 8, 12)),
    ]


def test_each_label_is_counted_alone() -> None:
    said = []
    lines = Lines(said.append, clock=Clock())
    for label in ("drive", "render"):
        lines(label, 0, 2)
    lines("drive", 2, 2)
    assert said == ["drive: 0 of 2 (0 %)", "render: 0 of 2 (0 %)", "drive: 2 of 2 (100 %)"]


def test_work_that_is_done_at_once_can_be_silent() -> None:
    said, clock = [], Clock()
    lines = Lines(said.append, 2.0, clock)
    for done in range(5):
        lines("plan", done, 100)
        clock.now += 0.6
    assert said == ["plan: 4 of 100 (4 %), 1.7/s, 58 s left"]


def test_durations() -> None:
    assert [write_time(seconds) for seconds in (0.2, 59.4, 60, 3599, 3600)] == [
        "0 s",
        "59 s",
        "1 min 00 s",
        "59 min 59 s",
        "1 h 00 min",
    ]


def test_bars_are_for_terminals_alone() -> None:
    for is_terminal in (False, True):
        file = io.StringIO()
        with show_progress(Console(file=file, force_terminal=is_terminal, width=80)) as report:
            report("drive [x]", 1, 2)
        assert (file.getvalue() == "drive [x]: 1 of 2 (50 %)\n") != is_terminal
        assert ("\x1b[" in file.getvalue()) == is_terminal


def test_a_label_with_brackets_is_no_markup() -> None:
    file = io.StringIO()
    with show_progress(Console(file=file, force_terminal=True, width=80)) as report:
        report("derive from [/x]", 1, 2)
    assert "derive from [/x]" in file.getvalue()


def test_errors_and_warnings_are_printed_as_they_are(capsys) -> None:
    for text in ("pattern 'a\\[/x]' :smile: [red]", "ends in \\", "[/]"):
        for kind in ("error", "warning", ""):
            console.print_error(kind, text)
            assert capsys.readouterr().err == f"{kind}: {text}\n".removeprefix(": ")


def test_warnings_of_all_modules_are_one_line_each(capsys) -> None:
    with console.show_warnings():
        logging.getLogger("sim.recording.collect").warning("%s was damaged\nand is made again", "features")
        logging.getLogger("deepgps.run").info("not said")
        logging.getLogger("elsewhere").info("not said")
    assert capsys.readouterr().err == "warning: features was damaged and is made again\n"
