"""Every published study: its report is what the code says of its table today, and its pictures can be drawn."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from deepgps.config.scenario import names_in
from deepgps.reports.style import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.report import list_pictures, measure_targets, report_study, varied_names, write_report
from deepgps.studies.study import Study, load_study
from deepgps.studies.table import Row, read_rows
from deepgps.terminal.progress import ignore
from sim.paths import STUDIES
from tests.helpers.small_study import run_all_here

RESULTS = STUDIES.parents[1] / "docs" / "results"
PUBLISHED = sorted(path.parent.name for path in RESULTS.glob("*/table.md"))
FROM_ROWS = {
    *("errors", "rooms", "seeds", "landmarks", "curves", "encoder", "near", "camera", "change", "knowing"),
    *("corridors", "maps", "diagnose", "lab", "concave"),
}
"""Pictures that need no run's files."""
WORDS = {
    "camera": "knocked 8° to the right",
    "change": "automatic exposure",
    "concave": "50-100 %",
    "corridors": "bedroom 1, 3.2 x 2.8 m, alike",
    "diagnose": "What was found",
    "encoder": "Which encoder keeps most of the room within 2 cm",
    "knowing": "| a part not driven",
    "maps": "maps mirrored in part, of 4",
    "networks": "turned [cm]",
}
"""What some reports of small studies must say."""


@cache
def load_published(name: str) -> tuple[Study, list[Row]]:
    study = load_study(name.removesuffix("-full"), tiny=False, full=name.endswith("-full"))
    return study, read_rows(RESULTS / name / "table.parquet")


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_report_is_made_of_the_table_alone(name: str) -> None:
    study, rows = load_published(name)
    plan = SimpleNamespace(scenario=SimpleNamespace(name="any"))
    written = write_report(study, [plan], {}, rows).splitlines()
    published = (RESULTS / name / "table.md").read_text().splitlines()
    assert written[3:] == published[3 : len(written)]  # below the number of runs
    assert "ade at " in published[len(written) + 1]
    figures = set(measure_targets(study.report, rows))
    assert figures & set(REPORTS[study.report].targets) or not REPORTS[study.report].targets


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_pictures_are_drawn(name: str, tmp_path: Path) -> None:
    study, rows = load_published(name)
    pictures = {key: draw for key, draw in list_pictures(study, rows, tmp_path).items() if key in FROM_ROWS}
    pictures.pop("rooms" if name == "concave" else "", None)  # error fields
    pictures.pop("near", None)  # as that of errors
    for draw in pictures.values():
        assert to_png(draw()).startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*names_in(STUDIES)])
def test_the_small_study_runs_to_its_pictures(name: str, tmp_path: Path) -> None:
    study = load_study(name, tiny=True)
    plans = plan_runs(study)
    assert carry_out(study, plans, tmp_path, run_all_here, ignore) == {}
    text = report_study(study, plans, {}, tmp_path)
    report, origin = text.rsplit("\n\n", 1)
    assert report + "\n" == write_report(study, plans, {}, read_rows(tmp_path / "table.parquet"))
    assert (WORDS.get(name, "") in report and origin.startswith("Made at ")) or name == "diagnose"
    assert set(varied_names(study)) <= set(read_rows(tmp_path / "table.parquet")[0])
    drawn = {path.stem for path in tmp_path.glob("figures/*.png") if path.stat().st_size > 10_000}
    assert drawn == set(REPORTS[study.report].pictures)
