"""Publishing: a study's results and their checksums; it can be repeated, and never replaces what is not its own."""

from pathlib import Path

import pytest

from deepgps.studies.reports import report
from deepgps.studies.reports.report import SUMS_FILE, publish
from deepgps.studies.study import Study, load_study
from sim.errors import InputError
from sim.files.atomic import write_bytes
from tests.helpers.small_study import write_study


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return load_study(str(write_study(tmp_path, report="compare", target={})), tiny=False)


def make_results(folder: Path, text: str) -> Path:
    for name in ("table.parquet", "table.md", "figures/errors.png", "figures/other.png"):
        write_bytes(folder / name, f"{name}: {text}".encode())
    return folder


def test_only_what_the_report_makes_is_published_with_its_checksums(study: Study, tmp_path: Path):
    publish(study, make_results(tmp_path / "out", "first"), tmp_path / "pages")
    names = {path.relative_to(tmp_path / "pages").as_posix() for path in (tmp_path / "pages").rglob("*.*")}
    assert names == {"table.parquet", "table.md", "figures/errors.png"}
    assert len((tmp_path / "pages" / SUMS_FILE).read_text().splitlines()) == 3


def test_interrupted_anywhere_it_can_be_repeated(study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pages = tmp_path / "pages"
    publish(study, make_results(tmp_path / "out", "first"), pages)
    make_results(tmp_path / "out", "second")
    for copied in range(3):
        left = [copied]

        def stop(path: Path, data: bytes, left: list[int] = left) -> None:
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
            write_bytes(path, data)

        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(report, "write_bytes", stop)
            publish(study, tmp_path / "out", pages)
    publish(study, tmp_path / "out", pages)
    assert (pages / "table.md").read_bytes() == (tmp_path / "out" / "table.md").read_bytes()
    assert len((pages / SUMS_FILE).read_text().splitlines()) == 3


def test_a_picture_that_is_no_longer_drawn_goes_and_a_user_s_stays(study: Study, tmp_path: Path):
    pages, out = tmp_path / "pages", make_results(tmp_path / "out", "first")
    publish(study, out, pages)
    (out / "figures" / "errors.png").unlink()
    publish(study, out, pages)
    assert not (pages / "figures" / "errors.png").exists()
    (pages / "figures" / "errors.png").write_bytes(b"a user's")
    with pytest.raises(InputError, match=r"errors\.png was not published by deepgps or has changed since"):
        publish(study, out, pages)
    assert (pages / "figures" / "errors.png").read_bytes() == b"a user's"
