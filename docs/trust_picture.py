"""Draw the picture of the page "When can I trust it?" from a run, and print the page's table.

``.venv/bin/deepgps run demo --methods registration knn posenet --deployment.drive-samples 1000 --out runs/trust``, then
``.venv/bin/python -m docs.trust_picture runs/trust``.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import read_all_headings
from deepgps.reports.plots import to_png
from deepgps.reports.run_figures import draw_error_field
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from docs.pictures import PICTURES, reduce
from sim.files.atomic import write_bytes
from sim.recording.format import open_truth

COLUMNS_OF_ALL, COLUMNS_OF_ACCEPTED = ("RMS, all", "p95", "max"), ("RMS, accepted", "p95", "max")
HEADINGS = ("method", "tests", *COLUMNS_OF_ALL, "accepted", *COLUMNS_OF_ACCEPTED, "68 % holds", "95 % holds")
ERRORS = ("rms", "p95", "max")


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
    first, field = next(iter(read_all_headings(run).items()))
    figure = draw_error_field(open_truth(run / "recording").free_space, field, first)
    write_bytes(PICTURES / "trust.png", reduce(to_png(figure)))
    print(tabulate_trust(read_metrics(run)["methods"]))
