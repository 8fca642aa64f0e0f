"""The commands that look at what runs have made: view, track, diagnose, runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from deepgps.commands.parse import OptionalFile, OptionalFolder, OptionalMethod, Plugins, RunFolder
from deepgps.terminal.console import console, errors, say
from deepgps.terminal.progress import show_progress
from sim.errors import InputError
from sim.files.atomic import check_overwrite


@dataclass(frozen=True)
class ViewArguments:
    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN [RUN]"), tyro.conf.Positional]
    """The folder of a run or of a study, or those of two runs to compare."""
    web: bool = False
    """Serve the viewer and the recording to a browser on this machine, until Ctrl-C."""
    port: Annotated[int | None, tyro.conf.arg(metavar="PORT")] = None
    """Port of the page that --web serves; its data comes from the next port. None: free ports."""
    plugin: Plugins = ()
    """Files of plugins, whose methods then have their titles and colours."""
    screenshot: Path | None = None
    """Write a picture of a tab as PNG instead of opening a window; needs a Vulkan driver, but no display."""
    tab: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """The tab of which --screenshot writes a picture, by its name; none: the first."""


def view_command(arguments: ViewArguments) -> None:
    """Open a run or a study in the Rerun viewer or a browser, or two runs with the difference of their error fields."""
    from deepgps.runs.run_folder import is_study, open_run

    folders = arguments.runs
    if len(folders) not in {1, 2}:
        raise InputError(f"deepgps view takes one folder, or two to compare, not {len(folders)}")
    if arguments.tab is not None and arguments.screenshot is None:
        raise InputError("--tab needs --screenshot")
    if arguments.port is not None and not arguments.web:
        raise InputError("--port needs --web")
    if arguments.screenshot is not None and arguments.web:
        raise InputError("--screenshot writes one picture and ends; leave out --web")
    for folder in folders:
        if len(folders) == 2 or not is_study(folder):
            open_run(folder)
    # These import Rerun and torch, which takes longer than checking the folders.
    from deepgps.viewer.show import choose_ports, is_screenshot, serve, view, write_screenshot

    if arguments.screenshot is not None:
        check_overwrite(arguments.screenshot, is_screenshot)
        write_screenshot(folders, arguments.screenshot, arguments.tab)
        say(f"wrote {arguments.screenshot}")
    elif arguments.web:
        serve(folders, choose_ports(arguments.port), say)
    else:
        view(folders)


@dataclass(frozen=True)
class TrackArguments:
    run: RunFolder
    """The folder of a run."""
    method: OptionalMethod = None
    """A method that is trained in it; none: its first."""
    drive: OptionalFolder = None
    """The folder of another recording of the same robot and room; none: the deployment drive."""
    tum: OptionalFolder = None
    """Write the paths as TUM files, which evo reads, to this folder; also the truth, if it is known."""
    plugin: Plugins = ()
    """Files of plugins, with methods of your own."""


def track_command(arguments: TrackArguments) -> None:
    """Track the robot through the deployment drive, or another recording, by single images and odometry together."""
    from deepgps.evaluation.track_run import track_run, write_tums
    from deepgps.reports.track_page import draw_track, print_track

    with show_progress(errors) as progress:
        tracked = track_run(arguments.run, arguments.method, arguments.drive, progress)
    print_track(tracked, console)
    written = [tracked.path.with_suffix(".npz"), tracked.path.with_suffix(".json"), draw_track(tracked)]
    if arguments.tum is not None:
        written += write_tums(arguments.tum, tracked)
    say(f"\nwrote {', '.join(str(path) for path in written if path)}")


@dataclass(frozen=True)
class NavigateArguments:
    run: RunFolder
    """The folder of a run of a simulated robot with a camera."""
    goals: int = 50
    """Number of goals, one after another."""
    methods: tuple[str, ...] = ()
    """Trained methods, dead_reckoning and truth (the true pose); none: the run's first and these two."""
    changes: bool = False
    """Drive in the light of another day, and every tenth time with furniture moved and a person in view."""
    to: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None
    """Drive to this place alone [m]."""
    frame: Literal["world", "map"] = "world"
    """Frame of --to: the world's, or that of the run's first method."""
    plugin: Plugins = ()
    """Files of plugins, with methods of your own."""


def navigate_command(arguments: NavigateArguments) -> None:
    """Drive a simulated robot to goals in the run's own room, by its own tracked positions, and score the drives."""
    if not 1 <= arguments.goals <= 10_000:
        raise InputError(f"--goals {arguments.goals}: must be from 1 to 10,000")
    from deepgps.evaluation.navigate_run import Order, navigate_run
    from deepgps.reports.navigate_page import print_drives
    from deepgps.runs.collect import choose_renderer
    from deepgps.viewer.navigation import write_drives

    choose_renderer()
    to, in_world = arguments.to, arguments.frame == "world"
    order = Order(1 if to else arguments.goals, arguments.methods, arguments.changes, to, in_world)
    with show_progress(errors) as progress:
        driven = navigate_run(arguments.run, order, progress)
    print_drives(driven, console)
    say(f"\nwrote {driven.folder}; look at it: rerun {write_drives(arguments.run, driven)}")


@dataclass(frozen=True)
class DiagnoseArguments:
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING"), tyro.conf.Positional]
    """The folder of a recording or of a run."""
    out: OptionalFile = None
    """The file to write; default: diagnosis.json in the run's folder; for a recording of no run, no file."""


def diagnose_command(arguments: DiagnoseArguments) -> None:
    """Say what is wrong with the wheels of a recording, how sure that is, and what to set; no ground truth is used."""
    from deepgps.diagnosis.store import diagnose_folder, is_diagnosis
    from deepgps.reports.wheels_page import print_diagnosis

    if arguments.out is not None:
        check_overwrite(arguments.out, is_diagnosis)
    with show_progress(errors) as progress:
        diagnosis, written = diagnose_folder(arguments.recording, arguments.out, progress)
    print_diagnosis(diagnosis, console)
    if written is not None:
        say(f"\nwrote {written}")


@dataclass(frozen=True)
class RunsArguments:
    folder: Annotated[Path, tyro.conf.arg(metavar="FOLDER"), tyro.conf.Positional] = Path("runs")
    """The folder whose runs are listed, with those one level further down; a study's folder, too."""
    empty_drives: bool = False
    """Remove the drives that are kept for later runs to share; the runs that exist keep theirs."""


def runs_command(arguments: RunsArguments) -> None:
    """List runs: what each changes in its scenario, its errors, its age, and the disk that all hold."""
    from deepgps.runs.run_table import measure_disk, tabulate_runs
    from deepgps.runs.shared_drive import STORE, empty_store, measure_store
    from sim.files.atomic import write_size

    if arguments.empty_drives:
        return empty_store(arguments.folder)
    print(tabulate_runs(arguments.folder))
    print(f"{write_size(measure_disk(arguments.folder))} in all; to empty it, remove the folder of any run or study")
    if size := measure_store(arguments.folder):
        print(f"{write_size(size)} of it in {arguments.folder / STORE}, which later runs share, as these runs do:")
        print("deepgps runs --empty-drives removes what no run keeps")
