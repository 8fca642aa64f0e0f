"""Runs from Python: what the command line does, with a run as the result."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deepgps.api.run import Run, load
from deepgps.config.plugins import load_plugins
from deepgps.config.scenario import Scenario, load_scenario, override_scenario
from deepgps.run import run
from deepgps.runs.collect import choose_renderer_for, list_undriven
from deepgps.runs.run_folder import default_folder, join_methods
from deepgps.runs.source import DEFAULT_METHODS, choose_folder, describe_recording, refuse_settings_of_drive
from deepgps.terminal.progress import Report, ignore, show_progress


def simulate(
    scenario: Scenario | str | Path,
    out: str | Path | None = None,
    methods: Sequence[str] | None = None,
    settings: Mapping[str, Any] | None = None,
    plugins: Sequence[str | Path] = (),
    fresh: bool = False,
    progress: bool = True,
) -> Run:
    """Run a scenario as ``deepgps run`` does: drive and record, train, evaluate, draw figures.

    A finished run is only opened, an interrupted one continues where it stopped, and methods that are trained in the
    folder already stay.

    Args:
        scenario: A scenario, the name of one, such as ``tiny``, or the path of a YAML file.
        out: The run's folder; None: runs/<scenario>/seed<seed>-<hash>.
        methods: Methods to train and compare; None: the scenario's own.
        settings: Values by dotted name that replace the scenario's, such as ``{"encoder.step_noise": 0.1}``; of a group
            given as a mapping, those that it names.
        plugins: Files of plugins to load.
        fresh: Whether to replace an existing run, once the new one is complete.
        progress: Whether to show the progress on standard error.

    Raises:
        InputError: A setting is wrong, or the folder holds another run.
        WorkError: There is no renderer, physics failed, or the disk is full.
    """
    load_plugins(plugins)
    chosen = _choose(scenario, {**(settings or {}), **_name_methods(methods)})
    folder = default_folder(chosen) if out is None else Path(out)
    chosen = chosen if fresh else join_methods(chosen, folder)
    with _prepare(list_undriven(chosen, folder, fresh), progress) as report:
        run(chosen, folder, fresh, report)
    return load(folder)


def train(
    recording: str | Path,
    methods: Sequence[str] | None = None,
    out: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    plugins: Sequence[str | Path] = (),
    fresh: bool = False,
    progress: bool = True,
) -> Run:
    """Train on a recording, your own or one of another run; evaluate if it holds the truth and test observations.

    Args:
        recording: The recording's folder, which the run links to.
        methods: Methods to train; None: those of ``settings``, or DeepGPS alone.
        out: The run's folder; None: runs/<recording>/seed<seed>-<hash>.
        settings: Values by dotted name, such as ``{"learn.train.steps": 2000}``; of the name and of ``learn`` alone.
        plugins: Files of plugins to load.
        fresh: Whether to replace an existing run, once the new one is complete.
        progress: Whether to show the progress on standard error.

    Raises:
        InputError: It is no finished recording, a setting is wrong or of the drive, or a method cannot learn from it.
    """
    load_plugins(plugins)
    home = Path(recording)
    defaults = {"methods": list(DEFAULT_METHODS)}
    chosen = {**defaults, **(settings or {}), **_name_methods(methods)}
    scenario = describe_recording(home, chosen)
    refuse_settings_of_drive(scenario, describe_recording(home, defaults), home, chosen, str)
    folder = choose_folder(home, scenario) if out is None else Path(out)
    scenario = scenario if fresh else join_methods(scenario, folder)
    with _prepare([], progress) as report:
        run(scenario, folder, fresh, report, home, "evaluate")
    return load(folder)


def _choose(scenario: Scenario | str | Path, overrides: Mapping[str, Any]) -> Scenario:
    if isinstance(scenario, Scenario):
        return override_scenario(scenario.model_dump(mode="json"), Path("scenario"), overrides)
    return load_scenario(str(scenario), overrides)


def _name_methods(methods: Sequence[str] | None) -> dict[str, Any]:
    return {} if methods is None else {"methods": list(methods)}


@contextmanager
def _prepare(undriven: Sequence[Scenario], progress: bool) -> Iterator[Report]:
    """Choose the renderer, and show the progress; afterwards the environment is as before."""
    # torch reads this when it is imported: threads that spin while they wait make a busy machine five times slower.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    before = os.environ.get("MUJOCO_GL")
    choose_renderer_for(undriven)
    try:
        if progress:
            from deepgps.terminal.console import errors

            with show_progress(errors) as report:
                yield report
        else:
            yield ignore
    finally:
        if before is None and os.environ.get("MUJOCO_GL") == "off":  # a lidar needs no renderer, but the next run may
            del os.environ["MUJOCO_GL"]
