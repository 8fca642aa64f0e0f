"""The arguments of each command but the scenario's settings."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class RunArguments:
    scenario: Annotated[str, tyro.conf.Positional]
    """A name in assets/scenarios, or the path of a YAML file."""
    out: Path | None = None
    """The run folder itself; without it runs/<scenario>/seed<seed>-<hash>."""
    fresh: bool = False
    """Throw away what stands in the run folder and begin anew."""
    live: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[HOST:PORT]")] = None
    """Show the run while it goes on: in a viewer that is opened for it, or in one that listens at HOST:PORT or at a
    rerun+http URL."""


@dataclass(frozen=True)
class StudyArguments:
    study: Annotated[str, tyro.conf.Positional]
    """A name in assets/studies, or the path of a YAML file."""
    out: Path | None = None
    """The study folder itself; without it runs/studies/<study>, with --tiny or --full <study>-tiny or <study>-full."""
    tiny: bool = False
    """The small version that the study describes, half a minute: it shows the way, its figures mean nothing."""
    full: bool = False
    """The long version, where the study describes one."""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: tasks of a Ray cluster, which needs the extra deepgps[ray]."""
    address: str | None = None
    """Of the Ray cluster, as auto or host:port; none: one is started here."""
    publish: Path | None = None
    """Copy table, report and figures to the folder of the study's name in this one, as docs/results."""
    fresh: bool = False
    """Throw away what stands in the study folder and begin anew."""


@dataclass(frozen=True)
class ViewArguments:
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """A run's folder or a study's, or two runs' to compare."""
    web: bool = False
    """Serve the viewer and the recording to a browser on this machine, until Ctrl-C."""
    port: int | None = None
    """Of the page that --web serves; its data comes from the next one. None: free ones."""


@dataclass(frozen=True)
class RoomsArguments:
    kinds: str = "all"
    """Kinds of room, separated by commas, or all."""
    seeds: str = "0-3"
    """Seeds, as 0-3 or 0,2,5."""
    out: Path = Path("rooms.png")
    """The picture to write."""


@dataclass(frozen=True)
class BenchArguments:
    out: Path = Path("bench.json")
    """The file to write; a copy is kept in runs/bench."""
    against: str | None = None
    """Show an earlier bench beside this one: last, or its file."""
    tiny: bool = False
    """Everything small, under a minute: it shows the way, its figures mean nothing and are not kept."""
    memory_samples: int | None = None
    """Observations of the long recording, 12 kB each on disk; none: a million."""


@dataclass(frozen=True)
class NoArguments:
    pass
