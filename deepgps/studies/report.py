"""What a study found: its table as Parquet, its report in Markdown and as figures."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure as Picture

from deepgps.figures import to_png
from deepgps.markdown import tabulate
from deepgps.report import method_title
from deepgps.studies import curves, landmarks, precision, seeds
from deepgps.studies.study import Plan, ReportName, Study
from deepgps.studies.table import ERRORS, Row, gather, write_errors, write_table
from deepgps.targets import Figure, tabulate_targets
from sim.files import write_bytes, write_text


class Kind(NamedTuple):
    """One kind of report: functions of the rows measured, two of them also of the names that vary."""

    report: Callable[[Sequence[Row], Sequence[str]], list[str]]
    measure: Callable[[Sequence[Row]], dict[str, Figure]]
    draw: Callable[[Sequence[Row], Sequence[str]], Picture] | None


def report_plain(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """Every run and method as it is."""
    cells = [[*(str(row[name]) for name in varied), method_title(row["method"]), *write_errors(row)] for row in rows]
    return [tabulate([*varied, "method", *ERRORS.values()], cells)]


KINDS: dict[ReportName, Kind] = {
    "plain": Kind(report_plain, lambda rows: {}, None),
    "precision": Kind(precision.report, precision.measure, precision.draw),
    "seeds": Kind(seeds.report, seeds.measure, seeds.draw),
    "landmarks": Kind(landmarks.report, landmarks.measure, landmarks.draw),
    "curves": Kind(curves.report, curves.measure, curves.draw),
}


def report_study(study: Study, plans: Sequence[Plan], failures: Mapping[str, str], folder: Path) -> str:
    """Write ``table.parquet``, ``table.md`` and ``figures`` of a study; returns the report in Markdown.

    Args:
        study: What was run.
        plans: Its runs.
        failures: Why runs failed, by their hash.
        folder: The study's folder.
    """
    rows = gather(plans, failures, folder)
    write_table(folder / "table.parquet", rows)
    text = write_report(study, plans, failures, rows)
    write_text(folder / "table.md", text)
    measured, draw = [row for row in rows if row["failure"] is None], KINDS[study.report].draw
    if measured and draw:
        write_bytes(folder / "figures" / f"{study.report}.png", to_png(draw(measured, varied_names(study))))
    return text


def publish(folder: Path, target: Path) -> None:
    """Copy what a study found, without its runs, to a folder that can be committed."""
    for path in [folder / "table.parquet", folder / "table.md", *sorted(folder.glob("figures/*.png"))]:
        write_bytes(target / path.relative_to(folder), path.read_bytes())


def write_report(study: Study, plans: Sequence[Plan], failures: Mapping[str, str], rows: Sequence[Row]) -> str:
    """The report in Markdown: the table, the targets, and what failed."""
    varied, kind = varied_names(study), KINDS[study.report]
    blocks = [f"# {study.name}", f"{len(plans)} runs of {study.scenario}, {len(failures)} failed."]
    measured = [row for row in rows if row["failure"] is None]
    if measured:
        blocks += kind.report(measured, varied)
        if figures := kind.measure(measured):
            blocks += ["## In all", tabulate_targets(figures, study.target, study.paper)]
    if failures:
        failed = {row["run"]: row for row in rows if row["failure"]}.values()
        cells = [[*(str(row[name]) for name in varied), row["run"], row["failure"]] for row in failed]
        blocks += ["## Failed", tabulate([*varied, "run", "reason"], cells)]
    return "\n\n".join(blocks) + "\n"


def varied_names(study: Study) -> list[str]:
    """Columns that tell the runs apart: settings by dotted name, and the seed where there are several."""
    names = dict.fromkeys([*(name for case in study.cases for name in case), *study.axes])
    return [*names, *(["seed"] if len(study.seeds) > 1 or not names else [])]
