"""Paths in the TUM format are read by evo, whose ATE and RPE are those of our own code."""

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit
from evo.tools import file_interface

from deepgps.evaluation.track_run import measure_ate, measure_rpe
from deepgps.tracking.track import is_tum, write_tum


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray]:
    """Files of two paths, and their poses."""
    folder, rng = tmp_path_factory.mktemp("paths"), np.random.default_rng(0)
    yaw = np.cumsum(rng.uniform(-0.5, 0.5, 200))
    true = np.column_stack([np.cumsum(0.1 * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0), yaw])
    found = true + rng.standard_normal((200, 3)) * [0.02, 0.02, 0.05] + [0.3, -0.2, 0.4]
    for name, pose in (("true", true), ("found", found)):
        write_tum(folder / f"{name}.tum", np.arange(200.0), pose)
    return folder, found, true


def read(folder: Path) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    one, two = (file_interface.read_tum_trajectory_file(folder / f"{name}.tum") for name in ("true", "found"))
    return sync.associate_trajectories(one, two)


def test_ate_is_that_of_evo(paths: tuple[Path, np.ndarray, np.ndarray]):
    folder, found, true = paths
    reference, estimate = read(folder)
    estimate.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    assert measure_ate(found[:, :2], true[:, :2]) == pytest.approx(
        ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-6
    )


def test_rpe_is_that_of_evo(paths: tuple[Path, np.ndarray, np.ndarray]):
    (folder, found, true), apart = paths, 10
    relations = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_rad
    for relation, ours in zip(relations, measure_rpe(found, true, apart), strict=True):
        rpe = metrics.RPE(relation, delta=apart, delta_unit=Unit.frames, all_pairs=True)
        rpe.process_data(read(folder))
        assert ours == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_rigid_motion_of_all_changes_neither():
    rng = np.random.default_rng(1)
    found, true = rng.uniform(-2.0, 2.0, (2, 50, 3))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = np.column_stack([found[:, :2] @ turn.T + 5.0, found[:, 2] + np.arctan2(0.8, 0.6)])
    assert measure_ate(moved[:, :2], true[:, :2]) == pytest.approx(measure_ate(found[:, :2], true[:, :2]))
    assert measure_rpe(moved, true, 3) == pytest.approx(measure_rpe(found, true, 3))
    assert measure_ate(moved[:, :2], found[:, :2]) == pytest.approx(0.0, abs=1e-9)


def test_a_pose_without_a_yaw_is_left_out_of_relative_errors():
    rng = np.random.default_rng(5)
    true = np.column_stack([rng.normal(0.0, 1.0, (40, 2)).cumsum(axis=0), rng.uniform(-1.0, 1.0, 40)])
    found = true + rng.normal(0.0, 0.01, true.shape)
    blind = found.copy()
    blind[7, 2] = np.nan
    assert measure_rpe(blind, true, 3) == pytest.approx(measure_rpe(found, true, 3), rel=0.1)
    assert np.isnan(measure_rpe(np.full_like(true, np.nan), true, 3)).all()


def test_evo_reads_what_was_written(tmp_path: Path):
    rng = np.random.default_rng(0)
    time, pose = np.arange(20) * 0.1 + 1.7e9, rng.uniform(-3.0, 3.0, (20, 3))
    pose[4] = np.nan
    write_tum(tmp_path / "path.tum", time, pose)
    one, kept = file_interface.read_tum_trajectory_file(tmp_path / "path.tum"), np.isfinite(pose).all(axis=1)
    assert np.allclose(one.timestamps, time[kept])
    assert np.allclose(one.positions_xyz[:, :2], pose[kept, :2], atol=1e-8)
    assert np.allclose(one.get_orientations_euler()[:, 2], pose[kept, 2], atol=1e-8)
    assert is_tum((tmp_path / "path.tum").read_bytes()) and not is_tum(b"0 0 0 0 0 0 0 1\n")
    write_tum(tmp_path / "path.tum", np.arange(3.0), np.ones((3, 2)))
    assert (tmp_path / "path.tum").read_text().splitlines()[1] == "0.000000 1 1 0 0 0 0 1", "no yaw: along x"
