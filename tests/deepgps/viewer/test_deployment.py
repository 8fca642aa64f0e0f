"""A tracked deployment drive: along each way, errors are those that were measured."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from deepgps.evaluation.track_run import track_run
from deepgps.reports.plots import colours_of
from deepgps.terminal.progress import ignore
from deepgps.viewer.deployment import COLOURS
from deepgps.viewer.error_field import REFUSED_RGBA
from deepgps.viewer.run import find_recording
from deepgps.viewer.stream import DEPLOYMENT
from tests.helpers.blueprints import count_rows, find_missing, read_entity, read_error_field


def test_the_errors_along_the_drive_are_those_of_the_track(finished_run: Path, tmp_path: Path) -> None:
    run, method = Path(shutil.copytree(finished_run, tmp_path / "run")), "deepgps_compass"
    find_recording(run)  # which shows no track yet, and is made again
    figures = track_run(run, method, None, ignore).figures
    path, root = find_recording(run), f"world/{DEPLOYMENT}"
    for name in COLOURS:
        measured = figures["paths"][name]
        arrows = np.linalg.norm(np.subtract(*read_error_field(path, method, f"{root}/{name}")), axis=1)
        rows = read_entity(path, f"{DEPLOYMENT}/error/{name}").sort_by(DEPLOYMENT)["Scalars:scalars"].drop_null()
        error = 10.0 ** (np.concatenate(rows.to_pylist()) - 2)
        assert len(error) == measured["images"]
        assert np.sqrt(np.mean(error**2)) == pytest.approx(measured["rms_m"], rel=1e-4)
        np.testing.assert_allclose(np.sort(np.maximum(arrows, 1e-4)), np.sort(error), rtol=1e-4, atol=1e-6)
        shown = read_entity(path, f"{root}/{name}/path")
        strips, packed = (shown[f"LineStrips3D:{part}"].to_pylist()[0] for part in ("strips", "colors"))
        assert len(strips) == len(error) - 1
        colours = np.array(packed, ">u4").view(np.uint8).reshape(-1, 4)
        seen = (colours != REFUSED_RGBA).any(axis=1)
        np.testing.assert_array_equal(colours[seen], colours_of(error[1:])[seen])
    counts = count_rows(path)
    assert counts[f"/{DEPLOYMENT}/polar"] == counts[f"/{DEPLOYMENT}/fisheye"] == figures["images"]
    assert find_missing(path) == []
