"""Every published study: its report is what the code says of its table today, and its pictures can be drawn."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deepgps.config.scenario import names_in
from deepgps.reports.plots import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.reports.report import list_pictures, measure_targets, report_study, varied_names, write_report
from deepgps.studies.study import Study, load_study
from deepgps.studies.table import Row, read_rows
from deepgps.terminal.progress import ignore
from docs.shorten import shorten
from sim.files import STUDIES
from sim.recording.format import check_recording, open_recording, read_manifest
from sim.sensors.camera.faults import decode
from tests.helpers.command import deepgps, drop_progress
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
BY_COMMAND = "noise_w"
"""The study whose small version is run by the command."""


def check_camera(plans: Sequence[Plan], rows: Sequence[Row], folder: Path) -> None:
    """Faults of finished images are derived, those in use share the training images, and half the light is half."""
    clean, noisy, dim, knocked = (folder / "recordings" / plan.recording for plan in plans)
    assert read_manifest(noisy).model_dump()["derived_from"] == clean.name
    check_recording(noisy)
    for other in (dim, knocked):
        np.testing.assert_array_equal(open_recording(clean).observation, open_recording(other).observation)
    assert open_recording(knocked / "use").turns is not None
    light = [decode(open_recording(recording).test_observation).mean() for recording in (dim, clean)]
    assert light[0] == pytest.approx(0.5 * light[1], rel=0.2)


def check_encoder(plans: Sequence[Plan], rows: Sequence[Row], folder: Path) -> None:
    """The room is driven once, and distances get worse with noise."""
    manifests = [path.read_text() for path in folder.glob("recordings/*/manifest.json")]
    assert sum("derived_from" not in text for text in manifests) == 1 < len(manifests)
    noisy = [row for row in rows if row["encoder.step_noise"] == 0.1]
    assert noisy and all(row["segment_rms_m"] > 10 * rows[0]["segment_rms_m"] for row in noisy)


CHECKS = {"camera": check_camera, "encoder": check_encoder}
"""What else holds of some small studies."""


@cache
def load_published(name: str) -> tuple[Study, list[Row]]:
    study = load_study(name.removesuffix("-full"), tiny=False, full=name.endswith("-full"))
    return study, read_rows(RESULTS / name / "table.parquet")


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_report_is_made_of_the_table_alone(name: str) -> None:
    study, rows = load_published(name)
    plan = SimpleNamespace(scenario=SimpleNamespace(name="any"))
    written = shorten(write_report(study, [plan], {}, rows)).splitlines()  # pyright: ignore
    published = (RESULTS / name / "table.md").read_text().splitlines()
    assert sum(line.startswith("|") for line in published) <= 14 and max(line.count("|") for line in published) <= 9
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
@pytest.mark.parametrize("name", [name for name in names_in(STUDIES) if name != BY_COMMAND])
def test_the_small_study_runs_to_its_pictures(name: str, tmp_path: Path) -> None:
    study = load_study(name, tiny=True)
    plans = plan_runs(study)
    assert carry_out(study, plans, tmp_path, run_all_here, ignore) == {}
    text = report_study(study, plans, {}, tmp_path)
    report, origin = text.rsplit("\n\n", 1)
    rows = read_rows(tmp_path / "table.parquet")
    assert report + "\n" == write_report(study, plans, {}, rows)
    assert (WORDS.get(name, "") in report and origin.startswith("Made at ")) or name == "diagnose"
    assert set(varied_names(study)) <= set(rows[0])
    drawn = {path.stem for path in tmp_path.glob("figures/*.png") if path.stat().st_size > 10_000}
    assert drawn == set(REPORTS[study.report].pictures)
    if name in CHECKS:
        CHECKS[name](plans, rows, tmp_path)


@pytest.mark.slow
def test_a_study_run_by_the_command_is_published_and_noise_of_the_encoders_does_not_reach_posenet(tmp_path: Path):
    done = deepgps("study", BY_COMMAND, "--tiny", "--out", "out", "--publish", "results", cwd=tmp_path)
    assert (done.returncode, drop_progress(done.stderr)) == (0, [])
    published = tmp_path / "results" / f"{BY_COMMAND}-tiny"
    names = {path.relative_to(published).as_posix() for path in published.rglob("*") if path.is_file()}
    assert names == {"table.md", "table.parquet", "figures/curves.png", "SHA256SUMS"}
    for name in names - {"SHA256SUMS"}:
        assert (published / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    rows = read_rows(published / "table.parquet")
    assert {row["scenario"] for row in rows} == {"landmarks", "tiny"}
    assert {row["encoder.step_noise"] for row in rows} == {0.0, 0.1}
    assert len({(row["scenario"], row["rms_m"]) for row in rows if row["method"] == "posenet"}) == 2
