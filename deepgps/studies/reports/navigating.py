"""The report "navigate": how robots reach goals by positions of each method, by dead reckoning, by the true pose."""

import json
from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.studies.reports.record import CHOICES, StudyReport, Table, Target
from deepgps.studies.table import Row

DRIVES = "drives"  # The column that holds figures of drives as JSON, by the source of positions
TITLES = {"dead_reckoning": "Dead reckoning", "truth": "True pose"}
MINIMA = ("success_0_1m", "success_0_2m", "spl", "runs_without_collision", "carried_success_0_2m", "late_success_0_1m")
"""Figures of which more is better."""
COLUMNS = "success_0_1m success_0_2m spl collisions_per_run final_distance_median_m final_distance_p95_m refused"
NOTE = (
    "Means over seeds. Shares of goals at which the robot said that it had arrived, and was within 0.1 or 0.2 m; SPL: "
    "success at 0.2 m, weighted by the shortest way over the driven one; collisions: contacts on the way to a goal."
)


def list_sources(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """A row for each source of positions of each run."""
    return [
        {**row, **figures, "source": TITLES.get(name) or title_of(name), "own": name not in TITLES}
        for row in rows
        for name, figures in json.loads(row.get(DRIVES) or "{}").items()
    ]


REPORTS = {
    "navigate": StudyReport(
        (Table("source", f"runs {COLUMNS}", title="All"), Table(f"source {CHOICES}", COLUMNS, title="Each room")),
        NOTE,
        prepare=list_sources,
        targets=[
            Target(name, f"{name.replace('_', ' ')} of trained methods", name, {"own": True}, at_least=name in MINIMA)
            for name in (*MINIMA, "refused", "collisions_per_run", "final_distance_p95_m")
        ],
        columns="from_runs:add_drives",
    )
}
