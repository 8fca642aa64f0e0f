"""The page of drives to goals: a table of their figures, and a line for each goal that was not reached."""

import numpy as np
from rich.console import Console

from deepgps.config.methods import title_of
from deepgps.evaluation.navigate_run import USEFUL_M, Driven
from deepgps.navigation.simulate import TRUTH, WHEELS
from deepgps.reports.table import fill, print_table, say, write_hundredths

COLUMNS = (
    ("within 0.1 m [%]", "success_0_1m", write_hundredths),
    ("0.2 m [%]", "success_0_2m", write_hundredths),
    ("SPL", "spl", "{:.2f}".format),
    ("contacts", "collisions_per_run", "{:.2f}".format),
    ("median [cm]", "final_distance_median_m", write_hundredths),
    ("95 % [cm]", "final_distance_p95_m", write_hundredths),
    ("refused [%]", "refused", write_hundredths),
    ("carried [%]", "carried_success_0_2m", write_hundredths),
    ("changed [%]", "changed_success_0_2m", write_hundredths),
    ("time [s]", "time_s", "{:.1f}".format),
)
TITLES = {WHEELS: "Dead reckoning", TRUTH: "True pose"}
MAX_LINES = 10  # Goals of a method about which a line is printed


def print_drives(driven: Driven, console: Console) -> None:
    """Print the table, and why goals were refused or missed."""
    rows = [[TITLES.get(name, title_of(name)), *fill(COLUMNS, one)] for name, one in driven.figures.items()]
    print_table(console, ("goals by", *(column[0] for column in COLUMNS)), rows)
    for name, log in driven.logs.items():
        goal, lines = driven.trips[name].alignment.apply(log["goal"]), []
        for number, place in enumerate(goal):
            end_m = float(np.linalg.norm(log["true"][log["row_goal"] == number][-1, :2] - place))
            why = log["reason"][number] or ("" if end_m < USEFUL_M else "the robot said that it had arrived")
            lines += [f"{name}, goal {number} ({place[0]:.2f}, {place[1]:.2f}): {why}, {end_m:.2f} m off"] * bool(why)
        say(console, *lines[:MAX_LINES], *[f"and {len(lines) - MAX_LINES} more"] * (len(lines) > MAX_LINES))
