"""The commands that run a scenario, or some of its stages."""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from deepgps.commands.begin import BEGUN
from deepgps.commands.scenario import RunArguments, parse_scenario
from deepgps.config.scenario import Scenario
from deepgps.runs.source import Source
from deepgps.terminal.console import console, errors, print_error, quote_path, say
from deepgps.terminal.failures import working_in
from deepgps.terminal.progress import Report, show_progress


def run_command(words: Sequence[str]) -> None:
    """Run a scenario: drive and record, train, evaluate, show."""
    arguments, source = parse_scenario("run", words, run_command.__doc__)
    scenario, folder = source.scenario, source.folder
    _check_before_work(arguments, source)
    # These import torch, which takes longer than all checks.
    from deepgps.evaluation.measure import NO_TESTS
    from deepgps.run import run
    from deepgps.runs.collect import write_log
    from deepgps.runs.run_folder import find_place

    place = find_place(folder, arguments.fresh)
    with (
        working_in(folder),
        show_progress(errors) as progress,
        _watch(arguments, scenario, place, progress) as report,
    ):
        metrics = run(scenario, folder, arguments.fresh, report, source.recording)
        if arguments.log is not None:
            write_log(scenario, folder, arguments.log, report)
    if metrics is None:
        say(f"{folder}: {NO_TESTS}")
        return
    from deepgps.reports.run_report import print_report

    print_report(folder, console, time.monotonic() - BEGUN)
    say(f"\nlook at it: deepgps view {quote_path(folder)}")


def stage_command(stage: str, about: str) -> Callable[[Sequence[str]], None]:
    """Make the command that runs one stage and the stages it needs; ``about`` describes it."""

    def command(words: Sequence[str]) -> None:
        arguments, source = parse_scenario(stage, words, about)
        scenario, folder = source.scenario, source.folder
        _check_before_work(arguments, source)
        from deepgps.evaluation.measure import NO_TESTS
        from deepgps.methods.train import ask_for_device
        from deepgps.run import STAGES
        from deepgps.runs.collect import write_log
        from deepgps.runs.run_folder import claim, find_place
        from deepgps.runs.source import link_recording

        place, done = find_place(folder, arguments.fresh), None
        with (
            working_in(folder),
            show_progress(errors) as progress,
            _watch(arguments, scenario, place, progress) as report,
            claim(scenario, folder, arguments.fresh) as place,
        ):
            if source.recording is not None:
                link_recording(source.recording, place)
            if stage != "collect":  # after collecting alone, training may happen on another machine
                ask_for_device(scenario, place)
            for name, work in STAGES.items():
                done = work(scenario, place, report)
                if name == "collect" and arguments.log is not None:
                    write_log(scenario, place, arguments.log, report)
                if name == stage:
                    break
        if stage == "evaluate" and done is None:
            say(f"{folder}: {NO_TESTS}")
        else:
            say(f"{stage} is done: {folder}")

    return command


collect_command = stage_command("collect", "Only drive and look: make the recording.")
train_command = stage_command("train", "Collect, and train the methods.")
evaluate_command = stage_command("evaluate", "Collect, train, and measure the methods.")


def _check_before_work(arguments: RunArguments, source: Source) -> None:
    """Check what the drive needs: that its log can be written, or that something can render it."""
    from deepgps.runs.collect import check_log, choose_renderer_for, list_undriven

    if arguments.log is not None:
        check_log(arguments.log, source.scenario)
    elif source.recording is None:
        choose_renderer_for(list_undriven(source.scenario, source.folder, arguments.fresh))


def _watch(
    arguments: RunArguments, scenario: Scenario, folder: Path, progress: Report
) -> AbstractContextManager[Report]:
    """The progress callback for the stages: the live view of a run if one is asked for, else ``progress`` itself."""
    if arguments.live is None:
        return nullcontext(progress)
    # Rerun reads this when it is imported. It also raises what it would log, and a lost viewer deserves only one line.
    os.environ.setdefault("RUST_LOG", "off")
    from deepgps.viewer.live import show_live

    return show_live(" ".join(arguments.live), scenario, folder, progress, lambda text: print_error("warning", text))
