"""The commands that run a scenario, or some of its stages."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepgps.commands.begin import START_S
from deepgps.commands.parse import watch
from deepgps.commands.scenario import parse_scenario
from deepgps.terminal.console import console, errors, quote_path, say
from deepgps.terminal.failures import working_in
from deepgps.terminal.progress import show_progress

if TYPE_CHECKING:
    from deepgps.run import Stage


def run_command(words: Sequence[str]) -> None:
    """Run a scenario: drive and record, train, evaluate, show."""
    folder, metrics = _run("run", words, run_command.__doc__, "show")
    if metrics is None:
        return
    from deepgps.reports.run_report import print_report
    from deepgps.runs.run_table import compare_with_latest

    print_report(folder, console, time.monotonic() - START_S)
    if beside := compare_with_latest(folder):
        say(f"\n{beside}")
    say(f"\nlook at it: deepgps view {quote_path(folder)}")


def collect_command(words: Sequence[str]) -> None:
    """Only drive and look: make the recording."""
    folder, _ = _run("collect", words, collect_command.__doc__, "collect")
    say(f"collect is done: {folder}")


def train_command(words: Sequence[str]) -> None:
    """Collect, and train the methods."""
    folder, _ = _run("train", words, train_command.__doc__, "train")
    say(f"train is done: {folder}")


def evaluate_command(words: Sequence[str]) -> None:
    """Collect, train, and measure the methods."""
    folder, metrics = _run("evaluate", words, evaluate_command.__doc__, "evaluate")
    if metrics is not None:
        say(f"evaluate is done: {folder}")


def _run(command: str, words: Sequence[str], about: str | None, last: "Stage") -> tuple[Path, dict[str, Any] | None]:
    """Run a command's stages up to the last one; returns the run's folder and figures, and says why there are none."""
    arguments, source = parse_scenario(command, words, about)
    scenario, folder = source.scenario, source.folder
    from deepgps.runs.collect import check_log, choose_renderer_for, list_undriven, write_log

    if arguments.log is not None:
        check_log(arguments.log, scenario)
    elif source.recording is None:
        choose_renderer_for(list_undriven(scenario, folder, arguments.fresh))
    # These import torch, which takes longer than all checks.
    from deepgps.evaluation.measure_run import NO_TESTS
    from deepgps.run import run
    from deepgps.runs.run_folder import find_place

    place = find_place(folder, arguments.fresh)
    with (
        working_in(folder),
        show_progress(errors) as progress,
        watch(arguments.live, "live:show_live", progress, scenario, place, progress) as report,
    ):
        metrics = run(scenario, folder, arguments.fresh, report, source.recording, last)
        if arguments.log is not None:
            write_log(scenario, folder, arguments.log, report)
    if metrics is None and last in {"evaluate", "show"}:
        say(f"{folder}: {NO_TESTS}")
    return folder, metrics
