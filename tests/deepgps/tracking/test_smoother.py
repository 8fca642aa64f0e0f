"""The smoother: the least squares of a drive, never worse than the filter, and unmoved by what it should not see."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from deepgps.tracking import fix
from deepgps.tracking.filter import State, estimate, run_forward, smooth
from deepgps.tracking.motion import SCALE_DISTANCE_M, SCALE_STD
from sim.geometry import wrap
from tests.helpers.synthetic_drive import (
    PLACE_STD_M,
    SPACING_M,
    STEP_STD_M,
    TURN_STD_RAD,
    YAW_STD_RAD,
    Drive,
    carry,
    make_drive,
)


def find_path(states: list[State]) -> np.ndarray:
    return np.array([[*one.position, one.yaw] for one in map(estimate, states)])


def measure_rms(found: np.ndarray, drive: Drive) -> float:
    return float(np.sqrt((np.square((found - drive.pose)[:, :2]).sum(axis=1)).mean()))


def fit_all(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Poses (M, 3) and their covariances (M, 3, 3) by least squares over poses and scales at once."""
    count = len(drive.pose)
    kept = np.exp(-SPACING_M / SCALE_DISTANCE_M)
    turn = np.array([one.turn for one in drive.motions[1:] if one])
    seen = np.array([[*one.position, one.yaw] for one in drive.fixes])

    def find_residuals(flat: np.ndarray) -> np.ndarray:
        pose, scale = flat[: 3 * count].reshape(count, 3), flat[3 * count :]
        x, y = np.diff(pose[:, :2], axis=0).T
        cos, sin = np.cos(pose[:-1, 2]), np.sin(pose[:-1, 2])
        way = np.column_stack([cos * x + sin * y - SPACING_M * (1.0 + scale[:-1]), cos * y - sin * x]) / STEP_STD_M
        turned = wrap(np.diff(pose[:, 2]) - turn) / TURN_STD_RAD
        missed = np.column_stack([pose[:, :2] - seen[:, :2], wrap(pose[:, 2] - seen[:, 2])])
        drift = (scale[1:] - kept * scale[:-1]) / (SCALE_STD * np.sqrt(1.0 - kept**2))
        spread = np.array([PLACE_STD_M, PLACE_STD_M, YAW_STD_RAD])
        return np.concatenate([way.ravel(), turned, (missed / spread).ravel(), drift, scale[:1] / SCALE_STD])

    fitted = least_squares(find_residuals, np.concatenate([drive.pose.ravel(), np.zeros(count)]), xtol=1e-12)
    covariance = np.linalg.inv(fitted.jac.T @ fitted.jac)
    blocks = [covariance[3 * one : 3 * one + 3, 3 * one : 3 * one + 3] for one in range(count)]
    return fitted.x[: 3 * count].reshape(count, 3), np.array(blocks)


@pytest.fixture
def without_heavy_tails(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fix, "DEGREES_OF_FREEDOM", 1e12)


@pytest.mark.usefixtures("without_heavy_tails")
def test_smoother_is_the_least_squares_of_all():
    drive = make_drive(np.random.default_rng(0), images=40, noise=0.5)
    states = smooth(run_forward(drive.motions, drive.fixes), drive.motions, drive.fixes)
    path, covariance = fit_all(drive)
    found = np.array([one.covariance[one.evidence.argmax(), :3, :3] for one in states])
    assert np.abs(find_path(states) - path)[:, :2].max() < 0.02 * PLACE_STD_M, "what is left is of linearising once"
    assert np.allclose(*(np.sqrt(np.diagonal(one, axis1=1, axis2=2)) for one in (found, covariance)), rtol=0.02)


@pytest.mark.parametrize(("outliers", "drives"), [(0.2, 6), pytest.param(0.0, 10, marks=pytest.mark.slow)])
def test_smoother_is_better_than_the_filter(outliers: float, drives: int):
    """In each of some drives; were it no better, that had a probability of 0.016 with six and 0.001 with ten."""
    for seed in range(drives):
        drive = make_drive(np.random.default_rng(seed), images=40, outliers=outliers)
        assert measure_rms(find_path(_smooth(drive)), drive) < measure_rms(find_path(_filter(drive)), drive)


def test_zero_noise_gives_the_exact_path():
    drive = make_drive(np.random.default_rng(1), noise=0.0)
    assert measure_rms(find_path(_smooth(drive)), drive) < 1e-9


def test_drive_backward_is_smoothed_alike():
    """Smoothing knows no direction: the last image of a drive is as well placed as the first."""
    ends = np.zeros(2)
    for seed in range(10):
        drive = make_drive(np.random.default_rng(seed), images=30)
        error = np.square(find_path(_smooth(drive)) - drive.pose)[:, :2].sum(axis=1)
        ends += error[0], error[-1]
    assert 0.5 < ends[0] / ends[1] < 2.0


def test_carried_robot_is_smoothed_on_both_sides():
    carried = carry(make_drive(np.random.default_rng(2), images=200))
    assert np.hypot(*(carried.pose[80] - carried.pose[79])[:2]) > 0.5
    assert measure_rms(find_path(_smooth(carried)), carried) < 0.02


def _filter(drive: Drive) -> list[State]:
    return run_forward(drive.motions, drive.fixes)


def _smooth(drive: Drive) -> list[State]:
    return smooth(run_forward(drive.motions, drive.fixes), drive.motions, drive.fixes)
