"""The command ``deepgps``: arguments in, exit code out; 0: done, 1: the work failed, 2: the input is wrong.

After a signal the exit code is 128 plus the signal's number. Output that nobody reads any more is dropped and does not
change the exit code: the work in progress is worth more than the pipe.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import Any

from deepgps.begin import BEGUN, IS_WORKER
from deepgps.cli_arguments import (
    HELP,
    BenchArguments,
    CompletionArguments,
    DiagnoseArguments,
    ExportArguments,
    ImportArguments,
    LocateArguments,
    NoArguments,
    RoomsArguments,
    RunArguments,
    RunsArguments,
    StudyArguments,
    TrackArguments,
    ViewArguments,
    list_words,
    parse,
    parse_kinds,
    parse_round_image,
    parse_scenario,
    parse_seeds,
)
from deepgps.command.completion import SHELLS
from deepgps.command.failures import explain, find_version, working_in
from deepgps.command.signals import ignore_signals, stop_at_signals
from deepgps.command.streams import flush_streams
from deepgps.command.terminal import console, errors, print_error, quote_path, say, show_warnings, warn_plainly
from deepgps.plugins import load_plugins
from deepgps.progress import Report, show_progress
from deepgps.scenario import Scenario, names_in
from deepgps.spelling import find_like, suggest
from sim.errors import InputError, WorkError
from sim.files import check_overwrite
from sim.paths import SCENARIOS, STUDIES
from sim.user_input import quote, shorten

if IS_WORKER:
    warn_plainly()  # a worker has no progress bars


def run_command(words: Sequence[str]) -> None:
    """Run a scenario: drive and record, train, evaluate, show."""
    from deepgps.figures.run_report import print_report
    from deepgps.run import run
    from deepgps.run_folder import find_place
    from deepgps.stages import NO_TESTS, check_log, choose_renderer_for, list_undriven, write_log

    arguments, source = parse_scenario("run", words, run_command.__doc__)
    scenario, folder = source.scenario, source.folder
    if arguments.log is not None:
        check_log(arguments.log, scenario)
    elif source.recording is None:
        choose_renderer_for(list_undriven(scenario, folder, arguments.fresh))
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
    print_report(folder, console, time.monotonic() - BEGUN)
    say(f"\nlook at it: deepgps view {quote_path(folder)}")


def stage_command(stage: str) -> Callable[[Sequence[str]], None]:
    """Make the command that runs one stage and the stages it needs."""

    def command(words: Sequence[str]) -> None:
        from deepgps.adopted_recording import link_recording
        from deepgps.run_folder import claim, find_place
        from deepgps.stages import (
            NO_TESTS,
            STAGES,
            ask_for_device,
            check_log,
            choose_renderer_for,
            list_undriven,
            write_log,
        )

        arguments, source = parse_scenario(stage, words, f"{SUMMARIES[stage].capitalize()}.")
        scenario, folder = source.scenario, source.folder
        if arguments.log is not None:
            check_log(arguments.log, scenario)
        elif source.recording is None:
            choose_renderer_for(list_undriven(scenario, folder, arguments.fresh))
        place, left_out, done = find_place(folder, arguments.fresh), None, None
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
            if stage == "train":
                from deepgps.figures.run_report import describe_left_out  # needs torch, which collecting does not

                left_out = describe_left_out(place, scenario.methods)
        if left_out:
            say(left_out)
        if stage == "evaluate" and done is None:
            say(f"{folder}: {NO_TESTS}")
        else:
            say(f"{stage} is done: {folder}")

    return command


def study_command(words: Sequence[str]) -> None:
    """Run a study: make every missing recording and run, one table of all runs, the report and the figures."""
    from deepgps.studies.catalog import REPORTS
    from deepgps.studies.study import load_study, plan_runs

    if not words or (words[0].startswith("-") and not set(HELP) & set(words)):
        raise InputError(f"deepgps study needs a study first: {', '.join(names_in(STUDIES))}, or a path")
    arguments = parse(StudyArguments, "study", words, study_command.__doc__)
    load_plugins(arguments.plugin)
    study = load_study(arguments.study, arguments.tiny, arguments.full)
    with show_progress(errors, quiet_s=2.0) as progress:
        plans = plan_runs(study, progress)
    # These import torch and matplotlib, which takes longer than checking a study.
    from deepgps.stages import choose_renderer_for
    from deepgps.studies.engine.engine import carry_out, claim_study, default_folder, list_undriven, open_engine
    from deepgps.studies.reports.report import check_publish, publish, report_study

    folder = arguments.out or default_folder(study)
    choose_renderer_for(list_undriven(study, plans, folder, arguments.fresh))
    if arguments.publish:
        check_publish(arguments.publish / study.name)
    with (
        working_in(folder),
        open_engine(arguments.engine, arguments.address) as run_all,
        claim_study(study, folder, arguments.fresh) as place,
    ):
        with show_progress(errors) as progress:
            failures = carry_out(study, plans, place, run_all, progress)
        say(report_study(study, plans, failures, place))
        if arguments.publish and failures:
            say(f"not copied to {arguments.publish / study.name}: some runs failed")
        elif arguments.publish:
            publish(study, place, arguments.publish / study.name)
            say(f"copied to {arguments.publish / study.name}")
        if len(failures) < len(plans) and not REPORTS[study.report].gather:
            from deepgps.viewer.study.study import write_study

            write_study(place)
        if failures:
            raise WorkError(f"{len(failures)} of {len(plans)} runs failed; {place / 'table.md'} says why")
    if REPORTS[study.report].gather:
        return
    run = folder / "runs" / plans[0].run
    say(f"look at it: deepgps view {quote_path(folder)}, or at a run: deepgps view {quote_path(run)}")


def view_command(words: Sequence[str]) -> None:
    """Open a run or a study in the Rerun viewer or a browser, or two runs with the difference of their error fields."""
    from deepgps.run_folder import is_study, open_run

    arguments = parse(ViewArguments, "view", words, view_command.__doc__)
    folders = arguments.runs
    if len(folders) not in {1, 2}:
        raise InputError(f"deepgps view takes one folder, or two to compare, not {len(folders)}")
    if arguments.port is not None and not arguments.web:
        raise InputError("--port needs --web")
    load_plugins(arguments.plugin)
    if arguments.screenshot is not None and arguments.web:
        raise InputError("--screenshot writes one picture and ends; leave out --web")
    for folder in folders:
        if len(folders) == 2 or not is_study(folder):
            open_run(folder)
    # These import Rerun and torch, which takes longer than checking the folders.
    from deepgps.viewer.window.show import view
    from deepgps.viewer.window.web import choose_ports, serve

    if arguments.screenshot is not None:
        from deepgps.viewer.window.screenshot import is_screenshot, write_screenshot

        check_overwrite(arguments.screenshot, is_screenshot)
        write_screenshot(folders, arguments.screenshot)
        say(f"wrote {arguments.screenshot}")
    elif arguments.web:
        serve(folders, choose_ports(arguments.port), say)
    else:
        view(folders)


def diagnose_command(words: Sequence[str]) -> None:
    """Say what is wrong with the wheels of a recording, how sure that is, and what to set; no ground truth is used."""
    arguments = parse(DiagnoseArguments, "diagnose", words, diagnose_command.__doc__)
    from deepgps.diagnosis.command import diagnose_folder, is_diagnosis
    from deepgps.figures.diagnosis_page import print_diagnosis

    if arguments.out is not None:
        check_overwrite(arguments.out, is_diagnosis)
    with show_progress(errors) as progress:
        diagnosis, written = diagnose_folder(arguments.recording, arguments.out, progress)
    print_diagnosis(diagnosis, console)
    if written is not None:
        say(f"\nwrote {written}")


def track_command(words: Sequence[str]) -> None:
    """Track the robot through the drive in use, or another recording, by single images and odometry together."""
    arguments = parse(TrackArguments, "track", words, track_command.__doc__)
    load_plugins(arguments.plugin)
    from deepgps.evaluation.track_run import track_run, write_tums
    from deepgps.figures.track_page import draw_track, print_track

    with show_progress(errors) as progress:
        tracked = track_run(arguments.run, arguments.method, arguments.drive, progress)
    print_track(tracked, console)
    written = [tracked.path.with_suffix(".npz"), tracked.path.with_suffix(".json"), draw_track(tracked)]
    if arguments.tum is not None:
        written += write_tums(arguments.tum, tracked)
    say(f"\nwrote {', '.join(str(path) for path in written if path)}")


def import_command(words: Sequence[str]) -> None:
    """Make a recording from the log of a robot: ROS 1 bags, ROS 2 db3 or MCAP files, or a folder of plain files."""
    arguments = parse(ImportArguments, "import", words, import_command.__doc__)
    if arguments.look == (arguments.config is not None or arguments.out is not None):
        raise InputError("deepgps import takes --look, or --config FILE and --out FOLDER")
    from deepgps.logs.look import look

    if arguments.look:
        with show_progress(errors) as progress:
            text = look(arguments.log, progress)
        print(text)
        return
    if arguments.config is None or arguments.out is None:
        raise InputError("deepgps import needs both --config FILE and --out FOLDER; --look proposes the file")
    from deepgps.logs.importing import import_log
    from deepgps.logs.robot_config import load_config
    from deepgps.logs.summary import write_summary
    from sim.files import sha256

    config = load_config(arguments.config)
    with show_progress(errors) as progress:
        about = import_log(arguments.log, config, arguments.out, progress, sha256(arguments.config))
    say(write_summary(about))
    method = " --methods deepgps_compass" if about["turns_seen"] else ""
    say(f"\nimported: {arguments.out}; train on it: deepgps run {quote_path(arguments.out)}{method}")


def export_command(words: Sequence[str]) -> None:
    """Write trajectories for other tools, or a trained method as a folder for a robot."""
    arguments = parse(ExportArguments, "export", words, export_command.__doc__)
    raw = parse_round_image(arguments)
    if not (arguments.onnx or arguments.mcap or arguments.list_formats()):
        raise InputError("deepgps export needs at least one of --tum, --csv, --mcap, --onnx")
    if raw is not None and not arguments.onnx:
        raise InputError("--centre and --radius-px are for --onnx")
    from deepgps.api.run import load
    from deepgps.export.command import default_folder, export_drives, export_onnx

    run, method, frame = load(arguments.run, arguments.plugin), arguments.method, arguments.frame
    folder, written = arguments.out or default_folder(arguments.run), []
    with working_in(folder), show_progress(errors) as progress:
        formats = arguments.list_formats()
        if formats or arguments.mcap:
            written += export_drives(run, folder, method, frame, formats, arguments.mcap, progress)
        if arguments.onnx:
            written += export_onnx(run, folder, method, frame, raw, progress)
    for path in written:
        say(f"wrote {path}")


def locate_command(words: Sequence[str]) -> None:
    """Say where images were taken: one line of JSON for each, as they come; exit code 1 if one could not be read."""
    arguments = parse(LocateArguments, "locate", words, locate_command.__doc__)
    circle = parse_round_image(arguments)
    from deepgps.api.run import load
    from deepgps.locate.command import Wish, locate_source
    from deepgps.locate.locate import describe

    run, wrong, total = load(arguments.run, arguments.plugin), 0, 0
    frame = arguments.frame or run.choose_frame(arguments.method)
    wish = Wish(arguments.method, frame, circle, arguments.config, arguments.track, arguments.causes)
    with (
        show_progress(errors, quiet_s=2.0) as progress,
        locate_source(run, arguments.source, sys.stdin.buffer, wish, progress) as found,
        _watch_located(arguments.live, run.folder / "recording", frame == "world") as show,
    ):
        for one in found:
            print(json.dumps(describe(one, frame)), flush=True)
            if one.pose is not None and one.polar is not None:
                pose = one.pose
                show(one.picture.time_s, one.polar, pose.position, pose.yaw, pose.radius_95, pose.accepted)
            wrong, total = wrong + (one.pose is None), total + 1
    if wrong:
        raise WorkError(f"{wrong} of {total} images could not be located; their lines say why")


def _watch_located(live: tuple[str, ...] | None, recording: Path, in_world: bool) -> AbstractContextManager[Any]:
    """What is called with each pose: it shows them in a viewer if that is asked for."""
    if live is None:
        return nullcontext(lambda *_: None)
    os.environ.setdefault("RUST_LOG", "off")  # as for the live view of a run
    from deepgps.viewer.live.located import show_located

    return show_located(" ".join(live), recording, in_world, lambda text: print_error("warning", text))


def runs_command(words: Sequence[str]) -> None:
    """List runs: what each changes in its scenario, its errors, and its age."""
    arguments = parse(RunsArguments, "runs", words, runs_command.__doc__)
    from deepgps.run_table import tabulate_runs

    print(tabulate_runs(arguments.folder))


def rooms_command(words: Sequence[str]) -> None:
    """Draw a contact sheet of generated rooms."""
    arguments = parse(RoomsArguments, "rooms", words, rooms_command.__doc__)
    kinds, seeds = parse_kinds(arguments.kinds), parse_seeds(arguments.seeds)
    from deepgps.stages import choose_renderer

    choose_renderer()
    from sim.tools.gallery import draw_gallery, is_gallery

    check_overwrite(arguments.out, is_gallery)
    with show_progress(errors) as progress:
        draw_gallery(kinds, seeds, arguments.out, progress)
    say(f"wrote {arguments.out}")


def bench_command(words: Sequence[str]) -> None:
    """Measure speed, latency, memory and steadiness against naive baselines and targets; takes up to 15 minutes."""
    arguments = parse(BenchArguments, "bench", words, bench_command.__doc__)
    from deepgps.stages import choose_renderer

    choose_renderer()
    from deepgps.bench.bench import choose_size, run_bench
    from deepgps.bench.rows import find_before, is_bench, list_notes, tabulate
    from sim.tools.render_bench import draw_poses, measure_rendering

    check_overwrite(arguments.out, is_bench)
    before = find_before(arguments.against)
    size = choose_size(arguments.tiny, arguments.memory_samples)
    with show_progress(errors) as progress:
        rows = run_bench(size, arguments.out, not arguments.tiny, draw_poses, measure_rendering, progress)
    console.print(tabulate(rows, before))
    console.print("\n".join(["", *list_notes(rows), ""]), style="dim", markup=False)
    say(f"wrote {arguments.out}")


def doctor_command(words: Sequence[str]) -> None:
    """Check this machine's renderer, packages, processor and device, and say how to fix what is missing."""
    parse(NoArguments, "doctor", words, doctor_command.__doc__)
    from rich.markup import escape

    from deepgps.learning.trainer import describe_device
    from sim.tools.doctor import diagnose

    findings = diagnose()
    for finding in findings:
        mark = "[green]ok[/green]  " if finding.ok else "[red]lack[/red]"
        console.print(f"{mark} {finding.name:<12} {escape(finding.text)}", soft_wrap=True)
        if not finding.ok:
            console.print(f"     {'':<12} cure: {escape(finding.cure)}", soft_wrap=True)
    console.print(f"[green]ok[/green]   {'device':<12} {describe_device()}")
    if not all(finding.ok for finding in findings):
        raise WorkError("something is missing; the remedies are listed above")


def completion_command(words: Sequence[str]) -> None:
    """Print a script that completes commands, scenarios, studies and options in a shell.

    For bash, put this line into ~/.bashrc: eval "$(deepgps completion bash)"
    For zsh, put this line into ~/.zshrc, after compinit: eval "$(deepgps completion zsh)"
    For fish: deepgps completion fish > ~/.config/fish/completions/deepgps.fish
    """
    arguments = parse(CompletionArguments, "completion", words, completion_command.__doc__)
    print(SHELLS[arguments.shell](list_words(SUMMARIES)))


COMMANDS: dict[str, Callable[[Sequence[str]], None]] = {
    "run": run_command,
    "collect": stage_command("collect"),
    "train": stage_command("train"),
    "evaluate": stage_command("evaluate"),
    "study": study_command,
    "view": view_command,
    "diagnose": diagnose_command,
    "track": track_command,
    "import": import_command,
    "export": export_command,
    "locate": locate_command,
    "runs": runs_command,
    "rooms": rooms_command,
    "bench": bench_command,
    "completion": completion_command,
    "doctor": doctor_command,
}

SUMMARIES = {
    "run": "run a scenario: drive, see, learn, measure, show",
    "collect": "only drive and look: make the recording",
    "train": "collect, and train the methods",
    "evaluate": "collect, train, and measure the methods",
    "study": "run a study: many scenarios, one table",
    "view": "open a run or a study in Rerun, or two runs with their difference",
    "import": "make a recording from the log of a robot",
    "diagnose": "say what is wrong with the wheels, and what to set",
    "track": "track the robot through a drive, by images and odometry",
    "export": "write trajectories for other tools, or a method for a robot",
    "locate": "say where images were taken, as they come",
    "runs": "list runs by what they change, with their errors",
    "rooms": "draw a contact sheet of generated rooms",
    "bench": "measure speed, latency and memory beside naive baselines",
    "completion": "print the completion script for bash, zsh or fish",
    "doctor": "check this machine and say how to fix what is missing",
}


def main(words: Sequence[str] | None = None) -> None:
    """Run the command line ``words`` (default: the process's own) and exit."""
    words = sys.argv[1:] if words is None else words
    # torch reads this when it is imported: threads that spin while they wait make a busy machine five times slower.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ["MPLBACKEND"] = "agg"  # figures are drawn off-screen; importing matplotlib fails with a backend it lacks
    stop_at_signals()
    code = 0
    try:
        try:
            with show_warnings():
                _dispatch(words)
        except SystemExit as ended:  # after --help
            code = ended.code if isinstance(ended.code, int) else 0
        flush_streams()
    except (Exception, KeyboardInterrupt) as error:
        number = ignore_signals()
        code, kind, text = explain(error, words, number)
        print_error(kind, text)
        with suppress(OSError):
            flush_streams()
        if number is not None:  # every file is intact, and a package stopped in mid-work may never end
            os._exit(code)
    ignore_signals()
    if code:
        sys.exit(code)


def _dispatch(words: Sequence[str]) -> None:
    first = words[0] if words else "help"
    if first in COMMANDS:
        COMMANDS[first](words[1:])
    elif first == "help" and words[1:]:
        _dispatch([*words[1:], "--help"])
    elif first in {"help", *HELP}:
        _print_help()
    elif first in {"-V", "--version"}:
        console.print(f"deepgps {find_version()}")
    elif first.startswith("-"):
        raise InputError(f"deepgps has no option {shorten(first)}; deepgps --help lists the commands")
    elif first in names_in(SCENARIOS) or Path(first).suffix in {".yaml", ".yml"}:
        raise InputError(f"command {quote(first)} does not exist, did you mean deepgps run {shorten(first)}?")
    else:
        hint = suggest([find_like(first, COMMANDS)]) or f"; there are {', '.join(COMMANDS)}"
        raise InputError(f"command {quote(first)} does not exist{hint}")


def _print_help() -> None:
    console.print("usage: deepgps COMMAND ...\nexample: deepgps run tiny\n")
    for name, text in SUMMARIES.items():
        say(f"  {name:<11} {text}")
    console.print("\ndeepgps COMMAND --help shows the options of a command.")


def _watch(
    arguments: RunArguments, scenario: Scenario, folder: Path, progress: Report
) -> AbstractContextManager[Report]:
    """The progress callback for the stages: the live view of a run if one is asked for, else ``progress`` itself."""
    if arguments.live is None:
        return nullcontext(progress)
    # Rerun reads this when it is imported. It also raises what it would log, and a lost viewer deserves only one line.
    os.environ.setdefault("RUST_LOG", "off")
    from deepgps.viewer.live.live import show_live

    return show_live(" ".join(arguments.live), scenario, folder, progress, lambda text: print_error("warning", text))


if __name__ == "__main__":
    main()
