"""Draw the picture of the page "When can I trust it?" from a run, and print the page's table.

``.venv/bin/deepgps run demo --methods registration knn posenet --deployment.drive-samples 1000 --out runs/trust``, then
``.venv/bin/python -m docs.trust_picture runs/trust``.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.reports.plots import add_scale, draw_field, explain_refused, to_png
from deepgps.reports.run_figures import plot_risk
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from docs.pictures import PICTURES, reduce
from sim.files.atomic import write_bytes
from sim.geometry import FreeSpace
from sim.recording.format import open_truth

COLUMNS_OF_ALL, COLUMNS_OF_ACCEPTED = ("RMS, all", "p95", "max"), ("RMS, accepted", "p95", "max")
HEADINGS = ("method", "tests", *COLUMNS_OF_ALL, "accepted", *COLUMNS_OF_ACCEPTED, "68 % holds", "95 % holds")
ERRORS = ("rms", "p95", "max")


def draw_trust(space: FreeSpace, fields: Mapping[str, ErrorField]) -> Figure:
    """The first method's error field with what it refuses, and the risk-coverage curve of all methods."""
    figure, first = Figure(figsize=(13, 4.9), layout="constrained"), next(iter(fields))
    left, right = figure.subplots(1, 2, width_ratios=[1.75, 1])
    draw_field(left, space, fields[first])
    left.set_title(f"error field: {title_of(first)}", loc="left", fontsize=12)
    add_scale(figure, [left])
    plot_risk(right, fields)
    right.set_title("what refusing leaves", loc="left", fontsize=12)
    explain_refused(figure, fields.values())
    return figure


def tabulate_trust(methods: Mapping[str, Any]) -> str:
    """A row for each method on the test grid, then for each on the deployment drive; errors in centimetres."""
    rows = [_row(name, "grid", values) for name, values in methods.items()]
    rows += [_row(name, "deployment drive", values["in_use"]) for name, values in methods.items() if "in_use" in values]
    return tabulate(HEADINGS, rows)


def _row(name: str, tests: str, values: Mapping[str, Any]) -> list[str]:
    of_all, accepted = ([f"{100 * values[f'{one}{of}_m']:.1f}" for one in ERRORS] for of in ("", "_accepted"))
    holds = [f"{100 * values[f'radius_{share}_holds']:.0f} %" for share in (68, 95)]
    return [title_of(name), tests, *of_all, f"{100 * values['accepted']:.1f} %", *accepted, *holds]


if __name__ == "__main__":
    run = Path(sys.argv[1])
    figure = draw_trust(open_truth(run / "recording").free_space, read_all_headings(run))
    write_bytes(PICTURES / "trust.png", reduce(to_png(figure)))
    print(tabulate_trust(read_metrics(run)["methods"]))
