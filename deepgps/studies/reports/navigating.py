"""The report "navigate": how robots reach goals by positions of each method, by dead reckoning, by the true pose."""

import json
from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.studies.reports.record import CHOICES, StudyReport, Table, Target
from deepgps.studies.table import Row

DRIVES = "drives"  # The column that holds figures of drives as JSON, by the source of positions
CHANGED = "changed"  # The run's method in dimmed light and, in a tenth of the drives, a changed room
TITLES = {"dead_reckoning": "Dead reckoning", "truth": "True pose", CHANGED: "The same, changed light and room"}
FIGURES = {
    "success_0_1m": "goals reached within 0.1 m",
    "success_0_2m": "goals reached within 0.2 m",
    "spl": "SPL",
    "runs_without_collision": "goals without a contact",
    "carried_success_0_2m": "within 0.2 m after it was carried elsewhere",
    "late_success_0_1m": "goals 21 to 50 within 0.1 m",
    "refused": "goals refused",
}
COLUMNS = (
    "success_0_1m success_0_2m spl collisions_per_run final_distance_median_m final_distance_p95_m refused "
    "late_success_0_1m"
)
NOTE = (
    "Means over seeds. Shares of goals at which the robot said that it had arrived, and was within 0.1 or 0.2 m; SPL: "
    "success at 0.2 m, weighted by the shortest way over the driven one; collisions: contacts on the way to a goal; "
    "late: goals 21 to 50."
)


def list_sources(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """A row for each source of positions of each run."""
    return [
        {**row, **figures, "source": TITLES.get(name) or title_of(name), "by": "own" if name == row["method"] else name}
        for row in rows
        for name, figures in json.loads(row.get(DRIVES) or "{}").items()
    ]


REPORTS = {
    "navigate": StudyReport(
        (Table("source", f"runs {COLUMNS}", title="All"), Table(f"source {CHOICES}", COLUMNS, title="Each room")),
        NOTE,
        prepare=list_sources,
        targets=[
            Target(name, title, name, {"by": "own"}, at_least=name != "refused") for name, title in FIGURES.items()
        ]
        + [
            Target(f"{CHANGED}_{name}", f"{FIGURES[name]}, {said}", of, {"by": CHANGED}, at_least=True)
            for name, said, of in (
                ("success_0_1m", "dimmed light", "success_0_1m"),
                ("success_0_2m", "furniture moved and a person", f"{CHANGED}_success_0_2m"),
            )
        ]
        + [
            Target(
                "over_truth",
                "success at 0.1 m over the true pose's",
                "success_0_1m",
                {"by": "own"},
                {"by": "truth"},
                at_least=True,
            )
        ],
        columns="from_runs:add_drives",
    )
}
