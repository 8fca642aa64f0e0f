"""Bench rows that take hours to measure, over rooms and seeds: they are read from the tables of the last studies."""

import subprocess
import time
from pathlib import Path

from deepgps.bench.rows import Row
from deepgps.figures.targets import FORMS
from deepgps.studies.reports.report import measure_targets
from deepgps.studies.study import load_study
from deepgps.studies.table import read_rows
from sim.files import read_json

STUDIES = ("precision", "seeds")
LATEST = Path("runs") / "studies"
COMMITTED = Path(__file__).parents[2] / "docs" / "results"


def read_studies() -> list[Row]:
    """Rows of the studies' figures that have a target; a figure of a study without a table has no value."""
    return [row for name in STUDIES for row in _read_study(name)]


def _read_study(name: str) -> list[Row]:
    study = load_study(name, tiny=False)
    found = next((path for path in _tables(name) if path.is_file()), None)
    if found is None:
        note = f"deepgps study {name}"
        return [Row(f"{name}.{key}", f"{name}: {key}", None, "", note=note) for key in study.target]
    rows = [row for row in read_rows(found) if row["failure"] is None]
    figures = measure_targets(study.report, rows) if rows else {}
    note = f"{len(rows)} trainings, {_origin(found, [row['run'] for row in rows])}"
    made = []
    for key, target in study.target.items():
        figure = figures.get(key)
        if figure is None or figure.value is None:
            made.append(Row(f"{name}.{key}", f"{name}: {key}", None, "", note=note))
            continue
        factor, _, after = FORMS[figure.unit]
        value, wanted, unit = factor * figure.value, factor * target, after.strip()
        title = f"{name}: {figure.title}"
        made.append(Row(f"{name}.{key}", title, value, unit, wanted, figure.at_least, note=note))
    return made


def _tables(name: str) -> list[Path]:
    return [LATEST / name / "table.parquet", COMMITTED / name / "table.parquet"]


def _origin(table: Path, runs: list[str]) -> str:
    """Date and commit of a table: with its runs, the table's date and their commit; else its own commit."""
    made_by = next((path for run in runs if (path := table.parent / "runs" / run / "metrics.json").is_file()), None)
    if made_by is not None:
        date = time.strftime("%Y-%m-%d", time.localtime(table.stat().st_mtime))
        return f"{date}, commit {read_json(made_by)['environment']['git']}"
    command = ["git", "-C", str(table.parent), "log", "-1", "--format=%cs, committed in %h", "--", table.name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "of unknown date"
