"""The command that runs a study."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from deepgps.commands.parse import HELP, OptionalFolder, Plugins, parse
from deepgps.config.plugins import load_plugins
from deepgps.config.scenario import names_in
from deepgps.terminal.console import errors, quote_path, say
from deepgps.terminal.failures import working_in
from deepgps.terminal.progress import show_progress
from sim.errors import InputError, WorkError
from sim.files import STUDIES


@dataclass(frozen=True)
class StudyArguments:
    study: Annotated[str, tyro.conf.arg(metavar="STUDY"), tyro.conf.Positional]
    """A name in assets/studies, or the path of a YAML file."""
    out: OptionalFolder = None
    """The study folder itself; default: runs/studies/<study>, with --tiny or --full <study>-tiny or <study>-full."""
    tiny: bool = False
    """Run the study's small version, which takes half a minute: it shows how a study works; its figures mean
    nothing."""
    full: bool = False
    """Run the study's long version, if it has one."""
    networks: bool = False
    """Train the study's networks, too, beside the methods that need no training."""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: tasks of a Ray cluster, which needs the extra deepgps[ray]."""
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """Address of the Ray cluster, as auto or host:port; none: a cluster is started here."""
    publish: OptionalFolder = None
    """Copy the table, report and figures to a subfolder of this folder named after the study, as in docs/results."""
    fresh: bool = False
    """Make the study again; the old one is replaced once the new one is complete."""
    plugin: Plugins = ()
    """Files of plugins, with methods and encoder faults of your own."""


def study_command(words: Sequence[str]) -> None:
    """Run a study: make every missing recording and run, one table of all runs, the report and the figures."""
    from deepgps.studies.plan import plan_runs
    from deepgps.studies.study import load_study

    if not words or (words[0].startswith("-") and not set(HELP) & set(words)):
        raise InputError(f"deepgps study needs a study first: {', '.join(names_in(STUDIES))}, or a path")
    arguments = parse(StudyArguments, "study", words, study_command.__doc__)
    load_plugins(arguments.plugin)
    study = load_study(arguments.study, arguments.tiny, arguments.full, arguments.networks)
    with show_progress(errors, quiet_s=2.0) as progress:
        plans = plan_runs(study, progress)
    # These import torch and matplotlib, which takes longer than checking a study.
    from deepgps.runs.collect import choose_renderer_for
    from deepgps.studies.engine.engine import carry_out, claim_study, find_missing, find_place, foresee, open_engine
    from deepgps.studies.engine.recordings import list_undriven
    from deepgps.studies.reports.report import publish, report_study

    folder = arguments.out or Path("runs") / "studies" / study.name
    place = find_place(folder, arguments.fresh)
    with show_progress(errors, quiet_s=2.0) as progress:
        missing = find_missing(plans, place, progress)
    undriven = list_undriven(plans, missing, place)
    choose_renderer_for(undriven)
    pages = arguments.publish and arguments.publish / study.name
    if pages and pages.exists() and not pages.is_dir():
        raise InputError(f"--publish: {pages} is not a folder")
    with (
        working_in(folder),
        open_engine(arguments.engine, arguments.address) as run_all,
        claim_study(study, folder, arguments.fresh),
    ):
        if expected := foresee(missing, undriven):
            errors.print(expected, highlight=False)
        with show_progress(errors) as progress:
            failures = carry_out(plans, missing, place, run_all, progress)
        with show_progress(errors, quiet_s=2.0) as progress:
            text = report_study(study, plans, failures, place, progress)
        say(text)
        if pages and failures:
            say(f"not copied to {pages}: some runs failed")
        elif pages:
            publish(study, place, pages)
            say(f"copied to {pages}")
        if len(failures) < len(plans):
            from deepgps.viewer.study import write_study

            with show_progress(errors, quiet_s=2.0) as progress:
                progress("recording for the viewer", 0, 1)
                write_study(place)
        if failures:
            raise WorkError(f"{len(failures)} of {len(plans)} runs failed; {place / 'table.md'} says why")
    run = folder / "runs" / plans[0].run
    say(f"look at it: deepgps view {quote_path(folder)}, or at a run: deepgps view {quote_path(run)}")
