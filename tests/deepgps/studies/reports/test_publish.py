"""Publishing: a study's results, which take the place of those before."""

from pathlib import Path

from deepgps.studies.reports.report import publish
from deepgps.studies.study import load_study
from sim.files.atomic import write_bytes
from tests.helpers.small_study import write_study


def test_what_the_report_makes_is_published_and_a_picture_that_it_no_longer_draws_goes(tmp_path: Path):
    study = load_study(str(write_study(tmp_path, report="compare", target={})), tiny=False)
    out, pages = tmp_path / "out", tmp_path / "pages"
    for name in ("table.parquet", "table.md", "figures/errors.png", "figures/other.png"):
        write_bytes(out / name, name.encode())
    for name in ("table.md", "figures/rooms.png", "notes.txt"):
        write_bytes(pages / name, b"before")
    publish(study, out, pages)
    left = {path.relative_to(pages).as_posix(): path.read_text() for path in pages.rglob("*.*")}
    made = {name: name for name in ("table.parquet", "table.md", "figures/errors.png")}
    assert left == made | {"notes.txt": "before"}
