"""The page of drives to goals: a table of their figures, and a line for each goal that was not reached."""

import numpy as np
from rich.console import Console

from deepgps.config.methods import title_of
from deepgps.evaluation.navigate_run import SUCCESS_LIMITS_M, Driven
from deepgps.navigation.simulate import TRUE_POSE, WHEELS
from deepgps.reports.table import choose, fill, head, print_table, say, write_hundredths

COLUMNS = (
    ("0.1 m [%]", "success_0_1m", write_hundredths),
    ("0.2 m [%]", "success_0_2m", write_hundredths),
    ("SPL [1]", "spl", "{:.2f}".format),
    ("touched [1]", "collisions_per_run", "{:.2f}".format),
    ("median [cm]", "final_distance_median_m", write_hundredths),
    ("95 % [cm]", "final_distance_p95_m", write_hundredths),
    ("refused [%]", "refused", write_hundredths),
    ("carried [%]", "carried_success_0_2m", write_hundredths),
    ("changed [%]", "changed_success_0_2m", write_hundredths),
)
"""Columns: heading, key, how it is written; one that no source has is left out."""
TITLES = {WHEELS: "Dead reckoning", TRUE_POSE: "True pose"}
MAX_LINES = 10  # Goals of a method about which a line is printed


def print_drives(driven: Driven, console: Console) -> None:
    """Print the table, and why goals were refused or missed."""
    columns = choose(COLUMNS, driven.figures.values())
    rows = [[TITLES.get(name, title_of(name)), *fill(columns, one)] for name, one in driven.figures.items()]
    print_table(console, ("positions", *head(columns)), rows)
    say(console, "\nShares of goals reached within 0.1 and 0.2 m, also after it was carried; contacts a goal.")
    for name, log in driven.logs.items():
        goal, lines = driven.trips[name].alignment.apply(log["goal"]), []
        for number, place in enumerate(goal):
            end_m = float(np.linalg.norm(log["true"][log["row_goal"] == number][-1, :2] - place))
            why = log["reason"][number] or "it said that it had arrived" * (end_m >= SUCCESS_LIMITS_M[-1])
            lines += [f"{name}, goal {number} ({place[0]:.2f}, {place[1]:.2f}): {why}, {end_m:.2f} m off"] * bool(why)
        say(console, *lines[:MAX_LINES], *[f"and {len(lines) - MAX_LINES} more"] * (len(lines) > MAX_LINES))
