"""The results of a study: its table as Parquet, and its report as Markdown and figures."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from deepgps.learning.trainer import use_threads
from deepgps.reports.plots import to_png
from deepgps.reports.run_report import judge_run, read_metrics
from deepgps.reports.table import tabulate
from deepgps.reports.targets import tabulate_targets
from deepgps.runs.provenance import describe_origin
from deepgps.runs.run_folder import METRICS
from deepgps.studies.catalog import PICTURES, REPORTS
from deepgps.studies.plan import Plan
from deepgps.studies.reports.pictures import draw
from deepgps.studies.reports.render import measure, prepare, write_blocks
from deepgps.studies.study import Study
from deepgps.studies.table import CASE, Row, gather, write_table
from deepgps.terminal.progress import Report, ignore
from sim.files.atomic import write_bytes, write_text

MAX_DOUBTS = 20  # Runs whose doubts a report lists
AddColumns = Callable[[Path, Row, Report], Row]
"""Returns a report's own columns of a row from its run's folder; what takes long reports its progress."""


def report_study(
    study: Study, plans: Sequence[Plan], failures: Mapping[str, str], folder: Path, progress: Report = ignore
) -> str:
    """Write ``table.parquet``, ``table.md`` and ``figures`` of a study; return the report in Markdown."""
    report = REPORTS[study.report]
    rows = gather(plans, failures, folder)
    write_table(folder / "table.parquet", rows)
    if report.columns:
        with use_threads(1):
            rows = add_columns(rows, resolve_name(f"deepgps.studies.reports.{report.columns}"), folder, progress)
        write_table(folder / "table.parquet", rows)
    runs = [folder / "runs" / plan.run for plan in plans]
    metrics = {run.name: read_metrics(run) for run in runs if (run / METRICS).is_file()}
    origin = describe_origin([one.get("environment", {}) for one in metrics.values()])
    doubts = describe_doubts(metrics, rows, varied_names(study))
    text = f"{write_report(study, plans, failures, rows)}\n{doubts}{origin}\n"
    write_text(folder / "table.md", text)
    if measured := [row for row in rows if row["failure"] is None]:
        varied = varied_names(study)
        prepared = prepare(report, measured, varied)
        for done, (name, picture) in enumerate(report.pictures.items()):
            progress("figures", done, len(report.pictures))
            write_bytes(folder / "figures" / f"{name}.png", to_png(draw(picture, prepared, varied, folder)))
        progress("figures", len(report.pictures), len(report.pictures))
    return text


def add_columns(rows: Sequence[Row], add: AddColumns, folder: Path, progress: Report) -> list[Row]:
    """Add a report's own columns to the rows; they are empty for failed runs."""
    added = []
    for done, row in enumerate(rows):
        progress("columns of the report", done, len(rows))
        added.append({} if row["failure"] else add(folder / "runs" / row["run"], row, progress))
    progress("columns of the report", len(rows), len(rows))
    names = dict.fromkeys(name for columns in added for name in columns)
    return [{**row, **dict.fromkeys(names), **columns} for row, columns in zip(rows, added, strict=True)]


def publish(study: Study, folder: Path, target: Path) -> None:
    """Copy a study's results, without its runs, to a folder that can be committed, in place of those before."""
    for name in PICTURES:
        (target / "figures" / f"{name}.png").unlink(missing_ok=True)
    for name in ("table.parquet", "table.md", *(f"figures/{name}.png" for name in REPORTS[study.report].pictures)):
        if (folder / name).is_file():
            write_bytes(target / name, (folder / name).read_bytes())


def write_report(study: Study, plans: Sequence[Plan], failures: Mapping[str, str], rows: Sequence[Row]) -> str:
    """The report in Markdown: the table, the targets, and the failed runs."""
    varied = varied_names(study)
    scenarios = " and ".join(dict.fromkeys(plan.scenario.name for plan in plans))
    blocks = [f"# {study.name}", f"{len(plans)} runs of {scenarios}, {len(failures)} failed."]
    if study.name.endswith("-tiny"):
        blocks.append("A small version of the study, a smoke test: its errors have no meaning.")
    measured = [row for row in rows if row["failure"] is None]
    if measured:
        report = REPORTS[study.report]
        prepared = prepare(report, measured, varied)
        blocks += write_blocks(report, prepared, varied)
        if figures := measure(report, prepared):
            blocks += ["## Summary", tabulate_targets(figures, study.target, study.paper)]
    if failures:
        failed = {row["run"]: row for row in rows if row["failure"]}.values()
        cells = [[*(str(row[name]) for name in varied), row["run"], row["failure"]] for row in failed]
        blocks += ["## Failed", tabulate([*varied, "run", "reason"], cells)]
    return "\n\n".join(blocks) + "\n"


def describe_doubts(metrics: Mapping[str, Mapping[str, Any]], rows: Sequence[Row], varied: Sequence[str]) -> str:
    """What runs say against their own results, by their names and what varies, at most ``MAX_DOUBTS`` of them."""
    found = {run: sentences for run, one in metrics.items() if "methods" in one and (sentences := judge_run(one))}
    names = {row["run"]: [one for one in varied if one in {CASE, "seed"}] if row.get(CASE) else varied for row in rows}
    case = {row["run"]: ", ".join(f"{name} {row[name]}" for name in names[row["run"]]) for row in rows}
    lines = [f"- `{run}` ({case[run]}): {' '.join(found[run])}" for run in list(found)[:MAX_DOUBTS]]
    lines += [f"- and {len(found) - MAX_DOUBTS} more"] if len(found) > MAX_DOUBTS else []
    head = f"Runs that doubt a result of theirs: {len(found) or 'none'} of {len(metrics)}."
    return "\n".join([head, "", *lines, *([""] if lines else [])]) + "\n" if metrics else ""


def varied_names(study: Study) -> list[str]:
    """Columns that tell the runs apart: settings by dotted name, and the seed if there are several."""
    names = dict.fromkeys([*(name for case in study.cases for name in case if name != "methods"), *study.axes])
    return [*names, *(["seed"] if len(study.seeds) > 1 or not names else [])]
