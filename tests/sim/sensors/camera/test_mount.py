"""A camera that leans sees what the lens says; one that is driven on sees the mean of where it was."""

import mujoco
import numpy as np
import pytest
from scipy import ndimage

from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.lens import make_lens, polar_rays, project_round
from sim.sensors.camera.mount import FRAMES, draw_leans, drive_on, tilt
from sim.settings import CameraMountSettings
from tests.sim.sensors.camera.test_fisheye import CAMERA, build_room, find_hits, place


def test_upright_is_no_lean_and_leans_have_their_mean_and_spread():
    rng = np.random.default_rng(0)
    assert draw_leans(CameraMountSettings(driven_m=0.1), 5, rng) is None
    fixed = draw_leans(CameraMountSettings(roll_deg=3.0, pitch_deg=-2.0), 5, rng)
    assert fixed is not None
    np.testing.assert_allclose(np.degrees(fixed), np.tile([3.0, -2.0], (5, 1)))
    wobbling = draw_leans(CameraMountSettings(roll_deg=3.0, wobble_deg=1.5), 20_000, rng)
    assert wobbling is not None
    assert np.degrees(wobbling.mean(axis=0)) == pytest.approx([3.0, 0.0], abs=0.05)
    assert np.degrees(wobbling.std(axis=0)) == pytest.approx([1.5, 1.5], rel=0.02)


def test_leans_of_a_shorter_drive_are_the_first_of_a_longer_one():
    settings = CameraMountSettings(wobble_deg=2.0)
    rng = np.random.default_rng(3)
    parts = [draw_leans(settings, count, rng) for count in (3, 4)]
    whole = draw_leans(settings, 7, np.random.default_rng(3))
    np.testing.assert_array_equal(np.concatenate([part for part in parts if part is not None]), whole)


def test_the_axis_leans_to_the_right_and_ahead():
    right, ahead = tilt(np.radians([10.0, 0.0])), tilt(np.radians([0.0, 10.0]))
    s, c = np.sin(np.radians(10.0)), np.cos(np.radians(10.0))
    np.testing.assert_allclose(right[:, 2], [0.0, -s, c])  # y is to the left
    np.testing.assert_allclose(ahead[:, 2], [s, 0.0, c])
    both = tilt(np.radians([4.0, -7.0]))
    np.testing.assert_allclose(both @ both.T, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(tilt(np.zeros(2)), np.eye(3))


@pytest.mark.parametrize("lean_deg", [(8.0, 0.0), (0.0, -12.0), (5.0, 6.0)])
def test_a_leaning_camera_sees_what_rays_cast_along_its_lens_hit(lean_deg: tuple[float, float]):
    model = build_room(40, flat=True)
    data, lean = place(model, 0.7, -0.4, 0.8), np.radians(lean_deg)
    colour = model.mat_rgba[model.geom_matid, :3] * 255
    with Fisheye(model, CAMERA) as fisheye:
        image, upright = fisheye.polar(data, lean), fisheye.polar(data)
    rays = polar_rays(make_lens(CAMERA), CAMERA.rings * 3, CAMERA.sectors * 3)

    def share_seen(turn: np.ndarray, image: np.ndarray) -> float:
        hits = find_hits(model, data, rays @ turn.T)
        reach = {"size": 7, "mode": ("nearest", "wrap")}
        alone = (ndimage.minimum_filter(hits, **reach) == ndimage.maximum_filter(hits, **reach))[1::3, 1::3]
        off = np.abs(image[alone] - colour[hits[1::3, 1::3][alone]]).max(axis=-1)
        return float(np.mean(off <= 2))

    # the axes by MuJoCo's own quaternions: first to the right about x, then ahead about y
    quat, other, matrix = np.zeros(4), np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, np.array([0.0, 1.0, 0.0]), lean[1])
    mujoco.mju_axisAngle2Quat(other, np.array([1.0, 0.0, 0.0]), lean[0])
    mujoco.mju_mulQuat(quat, quat.copy(), other)
    mujoco.mju_quat2Mat(matrix, quat)
    assert share_seen(matrix.reshape(3, 3), image) >= 0.99
    assert share_seen(np.eye(3), upright) >= 0.99
    assert share_seen(np.eye(3), image) < 0.98


def test_a_camera_ahead_of_the_axle_sees_what_one_on_an_axle_ahead_sees():
    model = build_room(40)
    ahead, left = CameraMountSettings(ahead_m=0.05), CameraMountSettings(left_m=0.05)
    with Fisheye(model, CAMERA) as fisheye:
        far, near = fisheye.polar(place(model, 0.75, -0.4, 0.0)), fisheye.polar(place(model, 0.7, -0.4, 0.0))
        aside = fisheye.polar(place(model, 0.7, -0.35, 0.0))
    with Fisheye(model, CAMERA, ahead) as fisheye:
        np.testing.assert_array_equal(fisheye.polar(place(model, 0.7, -0.4, 0.0)), far)
        back = fisheye.polar(place(model, 0.8, -0.4, np.pi))
        turned = fisheye.polar(place(model, 0.7, -0.45, np.pi / 2))
    assert np.abs(far.astype(int) - near).mean() > 1.0
    half, quarter = CAMERA.sectors // 2, CAMERA.sectors // 4
    assert np.abs(np.roll(back, half, axis=1).astype(int) - far).mean() < 1.0, "it turns with the robot"
    assert np.abs(np.roll(turned, quarter, axis=1).astype(int) - near).mean() < 1.0
    with Fisheye(model, CAMERA, left) as fisheye:
        np.testing.assert_array_equal(fisheye.polar(place(model, 0.7, -0.4, 0.0)), aside)


def test_an_optical_centre_that_is_off_shifts_the_round_image():
    lens, rings, sectors = make_lens(CAMERA), 60, 240
    rays = polar_rays(lens, rings, sectors, centre=0.1)
    seen = project_round(lens, rays, 480)  # what the sensor's pixels see, by their place around the true centre
    assumed = project_round(lens, polar_rays(lens, rings, sectors), 480)
    known = np.asarray(np.isfinite(rays).all(axis=-1))
    np.testing.assert_allclose((seen - assumed)[known], np.broadcast_to([24.0, 0.0], (known.sum(), 2)), atol=1e-6)
    assert 0.85 < known.mean() < 0.98
    assert known[-1].tolist()[0] and not known[-1].tolist()[sectors // 2], "dark where nothing falls on the sensor"


def test_the_way_driven_has_its_middle_at_the_state_and_leads_ahead():
    yaw, distance = 0.7, 0.1
    state = np.array([1.0, -2.0, 0.03, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2), 5.0, 6.0])
    states = drive_on(state, distance)
    assert len(states) == FRAMES
    np.testing.assert_allclose(states.mean(axis=0), state)
    np.testing.assert_allclose(states[:, 2:], np.tile(state[2:], (FRAMES, 1)))
    step = np.diff(states[:, :2], axis=0)
    np.testing.assert_allclose(step, np.tile(distance / FRAMES * np.array([np.cos(yaw), np.sin(yaw)]), (FRAMES - 1, 1)))
