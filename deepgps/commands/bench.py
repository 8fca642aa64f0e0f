"""The command that measures speed, latency and memory."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deepgps.commands.parse import File, parse
from deepgps.terminal.console import console, errors, say
from deepgps.terminal.progress import show_progress
from sim.files.atomic import check_overwrite


@dataclass(frozen=True)
class BenchArguments:
    out: File = Path("bench.json")
    """The file to write; a copy is kept in runs/bench."""
    against: Annotated[str | None, tyro.conf.arg(metavar="last|FILE")] = None
    """Show an earlier bench next to this one: last, or its file."""
    tiny: bool = False
    """Measure everything at a small size, in under a minute: the figures mean nothing and are not kept."""
    memory_samples: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of observations in the long recording, 12 kB each on disk; none: a million."""


def bench_command(words: Sequence[str]) -> None:
    """Measure speed, latency, memory and steadiness against naive baselines and targets; takes 15 to 30 minutes."""
    arguments = parse(BenchArguments, "bench", words, bench_command.__doc__)
    from deepgps.runs.collect import choose_renderer

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
