"""Columns that reports add to the table from the files of runs."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import NetworkSettings
from deepgps.evaluation.error_field import read_fields
from deepgps.evaluation.measures import find_seen, measure_visible
from deepgps.learning.networks import make_network
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.studies.reports import maps
from deepgps.studies.reports.explore import DONE_SHARE
from deepgps.studies.reports.from_runs import FLOOR_STRIDE, add_errors, add_explored, add_reach, measure_turn_spread
from sim.recording.format import open_truth


def test_only_the_invariant_network_does_not_see_a_turn() -> None:
    for architecture, sees in (("invariant", False), ("resnet", True), ("resnet_plain", True)):
        settings = NetworkSettings.model_validate({"architecture": architecture, "channels": 8})
        network = make_network(settings, 0, 2, torch.Generator().manual_seed(0)).eval()
        positioner = NetworkPositioner((8, 32, 3), None, settings, network, torch.zeros(2), torch.eye(2))
        images = np.random.default_rng(0).integers(0, 256, (3, 8, 32, 3), dtype=np.uint8)
        spread = measure_turn_spread(positioner, images)
        assert spread > 1e-3 if sees else spread < 1e-5


def test_the_columns_of_reach_hold_every_position(finished_run: Path) -> None:
    row = add_reach(finished_run, {"method": "deepgps"})
    field = read_fields(finished_run)["deepgps"]
    np.testing.assert_allclose(sorted(maps.pool([row])), sorted(field.error), rtol=1e-6)
    visible = measure_visible(open_truth(finished_run / "recording").free_space, field.truth)
    assert len(row["errors_5_m"]) == (visible >= 0.5).sum()


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
