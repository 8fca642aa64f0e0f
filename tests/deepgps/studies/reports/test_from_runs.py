"""Columns that reports add to the table from the files of runs."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.evaluation.measures import find_seen
from deepgps.studies.reports.from_runs import FLOOR_STRIDE, add_errors, add_explored
from deepgps.studies.reports.worlds import DONE_SHARE
from sim.recording.format import open_truth


def test_images_needed_are_the_fewest_that_leave_so_little_floor_unseen(finished_run: Path) -> None:
    row, truth = add_explored(finished_run, {}), open_truth(finished_run / "recording")
    space, place = truth.free_space, truth.pose[:, :2]
    floor = space.origin + np.argwhere(space.reachable)[::FLOOR_STRIDE, ::-1] * space.cell_m
    assert row["unseen_true"] == pytest.approx(1.0 - find_seen(floor, place).mean())
    for images in {row["images_needed"] - 1, row["images_needed"]} if row["reached"] else {len(place)}:
        is_enough = 1.0 - find_seen(floor, place[:images]).mean() <= DONE_SHARE
        assert is_enough == (row["reached"] and images == row["images_needed"])
    assert row["unseen"] is None


def test_places_near_the_truth_are_counted_at_their_worst_heading(tmp_path: Path) -> None:
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    predicted = np.stack([truth, truth + np.array([[0.0, 0.01], [0.0, 0.03], [0.04, 0.0], [0.0, 0.3]])], axis=1)
    np.savez(tmp_path / "error_field.npz", truth=truth, heading=np.zeros(2), deepgps=predicted)
    (tmp_path / "metrics.json").write_text('{"methods": {}, "distances": {"segment_rms_m": 0.1}}')
    columns = add_errors(tmp_path, {"method": "deepgps"})
    assert columns == pytest.approx({"within_2_cm": 0.25, "within_5_cm": 0.75, "segment_rms_m": 0.1})
