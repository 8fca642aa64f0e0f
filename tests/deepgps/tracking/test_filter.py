"""The filter: exact without noise, the same in every frame, consistent, and found again after the robot was carried."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from deepgps.positioner.pose import Poses
from deepgps.tracking.filter import advance, begin, estimate, run_forward, smooth, weigh
from deepgps.tracking.fix import Fix, take_fix
from deepgps.tracking.motion import make_motion, mirror, rotate
from sim.geometry import wrap
from tests.helpers.synthetic_drive import Drive, carry, make_drive, see


def track(drive: Drive) -> np.ndarray:
    """The filter's poses (M, 3)."""
    return np.array([[*one.position, one.yaw] for one in map(estimate, run_forward(drive.motions, drive.fixes))])


def miss(found: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Distances of poses (M, 3) from the true ones (M,) [m]."""
    return np.hypot(*(found - pose)[:, :2].T)


def test_zero_noise_gives_the_exact_path():
    drive = make_drive(np.random.default_rng(0), noise=0.0)
    found = track(drive)
    assert miss(found, drive.pose).max() < 1e-9
    assert np.abs(wrap(found[:, 2] - drive.pose[:, 2])).max() < 1e-9


def test_rigid_motion_of_the_map_moves_the_track_alike():
    drive, turned, away = make_drive(np.random.default_rng(1), outliers=0.1), 2.0, np.array([3.0, -4.0])
    turn = rotate(np.array(turned))
    fixes = [replace(one, position=turn @ one.position + away, yaw=wrap(one.yaw + turned)) for one in drive.fixes]
    found, moved = track(drive), track(replace(drive, fixes=fixes))
    assert np.allclose(moved[:, :2], found[:, :2] @ turn.T + away, atol=1e-9)
    assert np.allclose(wrap(moved[:, 2] - found[:, 2] - turned), 0.0, atol=1e-9)


def test_mirrored_map_gives_the_mirrored_track():
    drive, sign = make_drive(np.random.default_rng(2), outliers=0.1), np.array([1.0, -1.0])
    fixes = [replace(one, position=sign * one.position, yaw=-one.yaw) for one in drive.fixes]
    motions = [one and mirror(one) for one in drive.motions]
    assert np.allclose(track(Drive(drive.pose, motions, fixes)), track(drive) * [1.0, -1.0, -1.0], atol=1e-9)


def test_later_images_change_nothing_earlier():
    drive = make_drive(np.random.default_rng(3), outliers=0.2)
    part = Drive(drive.pose, drive.motions[:60], drive.fixes[:60])
    assert track(part).tobytes() == track(part).tobytes() == track(drive)[:60].tobytes()


def test_errors_are_as_large_as_expected():
    """The squared error over the covariance has the mean 2 for a position; robust weights make it a little smaller."""
    squared = []
    for seed in range(5):
        drive = make_drive(np.random.default_rng(seed))
        for state, true in list(zip(run_forward(drive.motions, drive.fixes), drive.pose, strict=True))[20::10]:
            best = state.evidence.argmax()
            error = state.mean[best, :2] - true[:2]
            squared.append(error @ np.linalg.solve(state.covariance[best, :2, :2], error))
    assert 1.4 < np.mean(squared) < 2.4


def test_better_than_single_images_and_robust_against_outliers():
    for seed in range(3):
        drive = make_drive(np.random.default_rng(seed), outliers=0.2)
        single = miss(np.array([[*one.position, 0.0] for one in drive.fixes]), drive.pose)
        error = miss(track(drive), drive.pose)[20:]
        assert np.sqrt((error**2).mean()) < 0.025 < np.sqrt((single**2).mean())


def test_carried_robot_is_found_again():
    carried = carry(make_drive(np.random.default_rng(2), images=200, outliers=0.2))
    assert np.hypot(*(carried.pose[80] - carried.pose[79])[:2]) > 0.5
    assert miss(track(carried), carried.pose)[80 + 25 :].max() < 0.1


def test_robot_that_says_it_was_carried_is_found_at_once():
    drive = make_drive(np.random.default_rng(0))
    away = [replace(one, position=one.position + 2.0) for one in drive.fixes[80:]]
    motions = [*drive.motions[:80], None, *drive.motions[81:]]
    states = run_forward(motions, [*drive.fixes[:80], *away])
    assert np.allclose(estimate(states[80]).position, away[0].position)
    assert not estimate(states[80]).accepted
    assert estimate(states[90]).accepted


def test_places_that_look_alike_are_told_apart_by_driving_on():
    """Every image shows one of two places, 3 m apart; the first few show the wrong one."""
    drive, rng = make_drive(np.random.default_rng(5)), np.random.default_rng(6)
    alike = [
        replace(one, position=one.position + [3.0, 0.0]) if number < 4 or rng.random() < 0.2 else one
        for number, one in enumerate(drive.fixes)
    ]
    error = miss(track(replace(drive, fixes=alike)), drive.pose)
    assert error[:3].min() > 2.0
    assert error[40:].max() < 0.1


def test_poses_that_one_image_may_be_of_are_told_apart_by_driving_on():
    """Every image is of two places, 3 m apart, and says that the wrong one is likelier."""
    drive = make_drive(np.random.default_rng(5))
    both = [
        replace(one, position=one.position + [3.0, 1.0], weight=0.6, others=(replace(one, weight=0.4),))
        for one in drive.fixes
    ]
    turned = [replace(one, yaw=one.yaw + 0.7 * number) for number, one in enumerate(both)]
    error = miss(track(replace(drive, fixes=turned)), drive.pose)
    assert error[:2].min() > 2.0 and error[60:].max() < 0.1


def test_place_that_is_not_mapped_is_not_taken_for_one_that_looks_alike():
    """After 60 images the robot leaves what is mapped, and for six metres all images show a place that is."""
    drive, away = make_drive(np.random.default_rng(5), images=110), np.array([30.0, 10.0])
    alike = [replace(one, position=one.position + away) for one in drive.fixes[60:]]
    left = replace(drive, fixes=[*drive.fixes[:60], *alike])
    mapped = KDTree(np.concatenate([drive.pose[:60, :2], drive.pose[60:, :2] + away]))
    unaware, aware = (
        miss(np.array([[*one.position, one.yaw] for one in map(estimate, states)]), drive.pose)
        for states in (run_forward(left.motions, left.fixes), run_forward(left.motions, left.fixes, mapped))
    )
    assert unaware[80:].min() > 10.0 and aware.max() < 0.5


def test_images_without_yaw_are_enough():
    drive = make_drive(np.random.default_rng(7))
    fixes = [replace(one, yaw=np.nan, yaw_std=np.nan) for one in drive.fixes]
    found = track(replace(drive, fixes=fixes))
    assert np.abs(wrap(found[40:, 2] - drive.pose[40:, 2])).max() < np.radians(5.0)
    assert miss(found, drive.pose)[40:].max() < 0.06


def test_odometry_with_a_wrong_scale_is_corrected():
    drive = make_drive(np.random.default_rng(8), images=300)
    motions = [one and replace(one, step=one.step * 1.05) for one in drive.motions]
    states = run_forward(motions, drive.fixes)
    assert abs(states[-1].mean[states[-1].evidence.argmax(), 3] + 0.05 / 1.05) < 0.01


def test_robot_that_does_not_move_learns_nothing_from_the_same_image():
    state = run_forward([None], [see(np.zeros(3))])[0]
    later = state
    for _ in range(50):
        later = advance(later, make_motion(0.0), see(np.zeros(3)))
    assert np.allclose(later.covariance, state.covariance, rtol=0.01)
    assert weigh(later) == pytest.approx(weigh(state))


def test_without_odometry_the_filter_still_follows():
    drive = make_drive(np.random.default_rng(9))
    unknown = make_motion(0.0, step_std_m=0.1, turn_std_rad=1.0)
    found = track(replace(drive, motions=[None, *[unknown] * 149]))
    assert np.median(miss(found, drive.pose)) < 0.03


def test_errors_of_images_are_found_by_odometry():
    """Positions that err ten times more than they say are averaged over a longer way."""
    drive = make_drive(np.random.default_rng(10), images=400)
    rng = np.random.default_rng(11)
    fixes = [replace(one, position=one.position + 0.2 * rng.standard_normal(2)) for one in drive.fixes]
    error = miss(track(replace(drive, fixes=fixes)), drive.pose)[100:]
    assert np.sqrt((error**2).mean()) < 0.12


def test_images_that_say_nothing_only_move_the_state():
    state = run_forward([None], [see(np.zeros(3))])[0]
    unknown = replace(see(np.ones(3)), position_std=np.inf)
    nowhere = replace(see(np.ones(3)), position=np.full(2, np.nan))
    for fix in (None, unknown, nowhere):
        assert np.allclose(estimate(advance(state, make_motion(0.1), fix)).position, [0.1, 0.0])
    assert estimate(begin()).probability == 0.0
    assert not estimate(advance(begin(), None, None)).accepted


def test_refused_images_count_less():
    drive = make_drive(np.random.default_rng(13))
    refused = replace(drive, fixes=[replace(one, accepted=False) for one in drive.fixes])
    spread = [estimate(run_forward(one.motions, one.fixes)[-1]).position_std for one in (drive, refused)]
    assert spread[1] > 1.5 * spread[0]
    assert not any(estimate(state).accepted for state in run_forward(refused.motions, refused.fixes))


@pytest.mark.parametrize("good", [0, 60])
def test_refused_images_alone_make_no_place_certain(good: int):
    """After some good images, or none, all others are refused and agree on a place three metres away."""
    drive = make_drive(np.random.default_rng(0), images=160)
    aside = [replace(one, accepted=False, position=one.position + [3.0, 0.0]) for one in drive.fixes[good:]]
    wrong = replace(drive, fixes=[*drive.fixes[:good], *aside])
    causal = run_forward(wrong.motions, wrong.fixes)
    for states in (causal, smooth(causal, wrong.motions, wrong.fixes)):
        found = [estimate(state) for state in states]
        off = miss(np.array([[*one.position, one.yaw] for one in found]), drive.pose) > 1.0
        assert not np.any([one.accepted for one in found] & off)


def test_lens_that_is_covered_does_not_lead_the_track_away():
    """All images from the 80th on show one place, which may be anywhere within metres."""
    drive = make_drive(np.random.default_rng(14), images=160)
    covered = Fix(np.array([3.0, 3.0]), 5.0, accepted=False)
    error = miss(track(replace(drive, fixes=[*drive.fixes[:80], *[covered] * 80])), drive.pose)
    assert error[80:].max() < 1.0, "the odometry errs by decimetres after 80 images"


def test_probabilities_leave_room_for_an_unknown_pose():
    drive = make_drive(np.random.default_rng(12), outliers=0.3)
    for state in run_forward(drive.motions, drive.fixes):
        assert 0.0 < weigh(state).sum() < 1.0


def test_filter_needs_numpy_alone():
    names = ("filter", "fix", "motion")
    imports = "; ".join(f"import deepgps.tracking.{name}" for name in names)
    code = f"import sys; {imports}; print('torch' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "False"


def test_a_method_s_radius_is_the_error_of_a_fix():
    pose = Poses(np.zeros(2))
    assert take_fix(pose).position_std == pytest.approx(0.02)
    assert take_fix(replace(pose, radius_68=np.array(0.15096))).position_std == pytest.approx(0.1)
    alike = replace(
        pose,
        yaw=np.array(0.1),
        yaw_std=np.array(0.02),
        accepted=np.array(False),
        reason=np.array(2),
        mode=np.array([[0.0, 0.0], [2.0, 0.0], [np.nan, np.nan]]),
        mode_yaw=np.array([0.1, 1.0, np.nan]),
        mode_weight=np.array([0.7, 0.3, 0.0]),
    )
    fix = take_fix(replace(alike, radius_68=np.array(0.01)))
    assert fix.accepted and fix.weight == 0.7 and [one.yaw for one in fix.others] == [1.0]
    refused = replace(pose, accepted=np.array(False))
    assert not take_fix(refused).usable
    assert take_fix(replace(refused, radius_68=np.array(1.0))).usable
