"""The command that runs a study."""

from collections.abc import Sequence
from dataclasses import dataclass
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
    from deepgps.studies.catalog import REPORTS
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
    from deepgps.studies.engine.engine import (
        carry_out,
        claim_study,
        default_folder,
        foresee,
        list_undriven,
        open_engine,
    )
    from deepgps.studies.reports.report import check_publish, publish, report_study

    folder = arguments.out or default_folder(study)
    undriven = list_undriven(study, plans, folder, arguments.fresh)
    choose_renderer_for(undriven)
    if arguments.publish:
        check_publish(arguments.publish / study.name)
    with (
        working_in(folder),
        open_engine(arguments.engine, arguments.address) as run_all,
        claim_study(study, folder, arguments.fresh) as place,
    ):
        if expected := foresee(study, plans, undriven, place):
            errors.print(expected, highlight=False)
        with show_progress(errors) as progress:
            failures = carry_out(study, plans, place, run_all, progress)
        say(report_study(study, plans, failures, place))
        if arguments.publish and failures:
            say(f"not copied to {arguments.publish / study.name}: some runs failed")
        elif arguments.publish:
            publish(study, place, arguments.publish / study.name)
            say(f"copied to {arguments.publish / study.name}")
        if len(failures) < len(plans) and not REPORTS[study.report].gather:
            from deepgps.viewer.study import write_study

            write_study(place)
        if failures:
            raise WorkError(f"{len(failures)} of {len(plans)} runs failed; {place / 'table.md'} says why")
    if REPORTS[study.report].gather:
        return
    run = folder / "runs" / plans[0].run
    say(f"look at it: deepgps view {quote_path(folder)}, or at a run: deepgps view {quote_path(run)}")
