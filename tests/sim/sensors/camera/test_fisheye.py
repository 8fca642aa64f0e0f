"""Laws of the fisheye image, on a small furnished room with a stand-in for the robot."""

import subprocess
import sys
from collections.abc import Iterator
from multiprocessing import get_context

import mujoco
import numpy as np
import pytest
from scipy import ndimage

from sim.errors import WorkError
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.lens import make_lens, polar_rays, project_polar, round_rays
from sim.settings import CameraSettings

CAMERA = CameraSettings(face_px=64)
SECTOR = 2 * np.pi / CAMERA.sectors
ROBOT = """<body name="robot/base"><freejoint/><inertial mass="1" pos="0 0 0.1" diaginertia="0.1 0.1 0.1"/>
  <geom name="robot/mast" type="cylinder" size="0.1 0.3" pos="0 0 0.31"/>
  <site name="robot/camera" pos="0 0 0.35" size="0.5"/></body>"""


def build_room(furniture: int, flat: bool = False, seed: int = 0) -> mujoco.MjModel:
    """Floor, four walls, ceiling and pieces along the walls: textured and lit, or each in one glowing colour."""
    rng = np.random.default_rng(seed)
    x, y, height = 3.5, 2.15, 2.5
    pieces = [((x, 0, 1.25), (0.05, y, 1.25)), ((-x, 0, 1.25), (0.05, y, 1.25)), ((0, 0, height), (x, y, 0.05))]
    pieces += [((0, y, 1.25), (x, 0.05, 1.25)), ((0, -y, 1.25), (x, 0.05, 1.25))]
    for _ in range(furniture):
        along, away = rng.uniform(-0.9, 0.9), rng.uniform(0.15, 0.5)
        place = [(x - away, along * y), (away - x, along * y), (along * x, y - away), (along * x, away - y)]
        pieces.append(((*place[rng.integers(4)], rng.uniform(0.1, 2.3)), tuple(rng.uniform(0.04, 0.3, 3))))
    assets, geoms = [], ['<geom name="floor" type="plane" size="3.5 2.15 0.1" material="m0"/>']
    for index in range(len(pieces) + 1):
        one, other = (" ".join(f"{part:.3f}" for part in colour) for colour in rng.uniform(0.1, 0.9, (2, 3)))
        pattern = f'builtin="checker" rgb1="{one}" rgb2="{other}" type="2d" width="64" height="64"'
        assets.append(f'<texture name="t{index}" {pattern}/>')
        look = f'rgba="{one} 1" emission="1"' if flat else f'texture="t{index}" texrepeat="3 3"'
        assets.append(f'<material name="m{index}" {look} specular="{0 if flat else 0.5}"/>')
    for index, (place, half) in enumerate(pieces, start=1):
        kind = "box" if flat or index % 5 else ("cylinder", "sphere", "capsule")[index % 3]
        spin = rng.integers(0, 90)
        geoms.append(
            f'<geom name="g{index}" type="{kind}" pos="%.3f %.3f %.3f" size="%.3f %.3f %.3f" ' % (*place, *half)
            + f'euler="0 0 {0 if index < 6 else spin}" material="m{index}"/>'
        )
    # the headlight, which Fisheye must tame, turns with the view except in the glowing room
    light = (
        '<headlight ambient="0 0 0" diffuse="0 0 0" specular="0 0 0"/>'
        if flat
        else '<headlight ambient="0.5 0.5 0.5"/>'
    )
    lamp = "" if flat else '<light pos="0.5 0 2.2" dir="0 0 -1" cutoff="90" diffuse="0.8 0.8 0.8"/>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><visual>{light}<quality offsamples="0" numslices="12" numstacks="6"/></visual>'
        f"<asset>{''.join(assets)}</asset><worldbody>{lamp}{''.join(geoms)}{ROBOT}</worldbody></mujoco>"
    )


def place(model: mujoco.MjModel, x: float, y: float, yaw: float, pitch: float = 0.0) -> mujoco.MjData:
    data = mujoco.MjData(model)
    turn, tip = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0, 1]), yaw)
    mujoco.mju_axisAngle2Quat(tip, np.array([0.0, 1, 0]), pitch)
    data.qpos[:3] = x, y, 0
    mujoco.mju_mulQuat(data.qpos[3:7], turn, tip)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture(scope="module")
def room() -> mujoco.MjModel:
    return build_room(90)


@pytest.fixture(scope="module")
def fisheye(room: mujoco.MjModel) -> Iterator[Fisheye]:
    with Fisheye(room, CAMERA) as camera:
        yield camera


def grey_difference(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one.astype(float) - other).mean())


def test_turning_left_shifts_the_polar_image_in_a_circle(room: mujoco.MjModel, fisheye: Fisheye) -> None:
    for x, y, yaw in [(0.5, -0.3, 0.3), (-2.0, 1.0, 2.1), (2.4, -1.2, -1.0)]:
        before = fisheye.polar(place(room, x, y, yaw))
        for sectors in (1, 17, 64, 111):
            after = fisheye.polar(place(room, x, y, yaw + sectors * SECTOR))
            assert grey_difference(np.roll(before, -sectors, axis=1), after) < MAX_RIGHT_ERROR
            if sectors != 64:
                assert grey_difference(np.roll(before, sectors, axis=1), after) > MIN_WRONG_ERROR


MAX_RIGHT_ERROR, MIN_WRONG_ERROR = 1.8, 4.5  # mean grey levels; measured 0.7 to 1.4, and 6.4 (one sector) to 35


def find_hits(model: mujoco.MjModel, data: mujoco.MjData, rays: np.ndarray) -> np.ndarray:
    """Geom that each ray (..., 3) in the camera's frame hits first, robot apart."""
    directions = rays.reshape(-1, 3) @ data.site("robot/camera").xmat.reshape(3, 3).T
    geoms, distances = np.empty(len(directions), np.int32), np.empty(len(directions))
    origin, groups, robot = data.site("robot/camera").xpos, np.array([1, 1, 1, 0, 0, 0], np.uint8), 1
    mujoco.mj_multiRay(
        model, data, origin, directions.ravel(), groups, 1, robot, geoms, distances, None, len(directions), 1e3
    )
    return geoms.reshape(rays.shape[:-1])


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        CameraSettings(distortion=(0.05, -0.01, 0.0, 0.0), rings=48, sectors=200),
        CameraSettings(field_of_view_deg=80),
        CameraSettings(field_of_view_deg=120, face_px=77),
    ],
    ids=["190 deg", "distorted", "80 deg", "120 deg, odd faces"],
)
def test_rays_cast_along_the_lens_hit_what_the_image_shows(camera: CameraSettings) -> None:
    model = build_room(40, flat=True)
    data = place(model, 0.7, -0.4, 0.8, pitch=0.1)
    lens = make_lens(camera)
    colour = model.mat_rgba[model.geom_matid, :3] * 255
    with Fisheye(model, camera) as fisheye:
        polar, picture = fisheye.polar(data), fisheye.round(data, 150)
    for image, rays in [
        (polar, polar_rays(lens, camera.rings * 3, camera.sectors * 3)),
        (picture, round_rays(lens, 450)),
    ]:
        known = np.isfinite(rays[..., 0])
        hits = np.where(known, find_hits(model, data, np.where(known[..., None], rays, [0, 0, 1.0])), -1)
        # away from edges: one geom alone in the pixel and in two thirds of a pixel around it
        reach = {"size": 7, "mode": ("nearest", "wrap")}
        lowest, highest = (ndimage.minimum_filter(hits, **reach), ndimage.maximum_filter(hits, **reach))
        alone, hits = np.logical_and(lowest == highest, hits >= 0)[1::3, 1::3], hits[1::3, 1::3]
        off = np.abs(image[alone] - colour[hits[alone]]).max(axis=-1)
        assert alone.mean() > 0.5
        assert np.mean(off <= 2) >= 0.99


def test_the_rim_sees_the_floor_below_the_horizon() -> None:
    model = build_room(0, flat=True)
    data = place(model, 3.1, 0.0, 0.0)  # the floor left of 3.1 m shows below the horizon, the wall ahead hides it
    with Fisheye(model, CameraSettings(rings=96, face_px=64)) as fisheye:
        rim = fisheye.polar(data)[-1].astype(float)
    hit = find_hits(model, data, polar_rays(make_lens(CAMERA), 96, CAMERA.sectors)[-1])
    floor = np.equal(hit, model.geom("floor").id)
    assert 0 < floor.sum() < len(floor)
    colour = model.mat_rgba[model.geom_matid[hit], :3] * 255
    assert np.mean(np.abs(rim - colour).max(axis=-1) < 3) > 0.95
    assert rim.min() > 0


def test_the_round_picture_agrees_with_the_polar_image(room: mujoco.MjModel, fisheye: Fisheye) -> None:
    data = place(room, 0.5, -0.3, 0.3)
    polar, picture = fisheye.polar(data).astype(float), fisheye.round(data, 160).astype(float)
    rays = round_rays(make_lens(CAMERA), 160)
    known = np.isfinite(rays[..., 0])
    row, column = np.moveaxis(project_polar(make_lens(CAMERA), rays[known], CAMERA.rings, CAMERA.sectors), -1, 0)
    inside = (row >= 0) & (row <= CAMERA.rings - 1)
    from_polar = polar[np.rint(row[inside]).astype(int), np.rint(column[inside]).astype(int) % CAMERA.sectors]
    assert grey_difference(picture[known][inside], from_polar) < 5
    assert grey_difference(picture[:, ::-1][known][inside], from_polar) > 12  # mirrored
    assert picture[0, 0].max() == 0


def test_nothing_of_the_robot_and_no_site_is_seen(room: mujoco.MjModel) -> None:
    data = place(room, 0, 0, 0)
    bare = build_room(90)
    bare.geom("robot/mast").group = 4
    with Fisheye(room, CAMERA) as one, Fisheye(bare, CAMERA) as other:
        assert np.array_equal(one.polar(data), other.polar(data))


def test_geoms_left_out_of_a_face_would_not_be_seen_in_it(
    room: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = place(room, 1.0, 0.4, 0.5, pitch=-0.05)
    with Fisheye(room, CAMERA) as fisheye:
        culled = fisheye.polar(data)
        monkeypatch.setattr(
            fisheye,
            "_find_seen",
            lambda _, geoms, *place: np.ones((len(fisheye._faces), len(geoms)), bool) & ~fisheye._robot[geoms],
        )
        assert np.array_equal(fisheye.polar(data), culled)


def draw_once() -> bytes:
    model = build_room(30)
    with Fisheye(model, CAMERA) as fisheye:
        return fisheye.polar(place(model, 0.3, 0.2, 0.1)).tobytes()


def test_the_same_state_gives_the_same_bytes_again_and_in_another_process() -> None:
    first = draw_once()
    assert draw_once() == first
    with get_context("spawn").Pool(1) as pool:
        assert pool.apply(draw_once) == first


def test_two_cameras_side_by_side_do_not_disturb_each_other(room: mujoco.MjModel, fisheye: Fisheye) -> None:
    data = place(room, 0.5, -0.3, 0.3)
    alone = fisheye.polar(data)
    with Fisheye(room, CameraSettings(face_px=32)) as other:
        other.polar(data)
        assert np.array_equal(fisheye.polar(data), alone)
    assert np.array_equal(fisheye.polar(data), alone)


@pytest.mark.parametrize("after", ["", "from dm_control.mujoco import Physics"], ids=["alone", "dm_control ends EGL"])
def test_a_camera_that_is_never_closed_leaves_quietly(after: str) -> None:
    made = "m = build_room(3); f = Fisheye(m, CAMERA); f.polar(place(m, 0, 0, 0))"
    code = f"from tests.sim.sensors.camera.test_fisheye import *; {made}; {after}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""


def test_a_closed_camera_says_so_and_the_renderer_has_a_name(room: mujoco.MjModel) -> None:
    fisheye = Fisheye(room, CAMERA)
    assert len(fisheye.renderer_string) > 3
    fisheye.close()
    fisheye.close()
    with pytest.raises(WorkError, match="closed"):
        fisheye.polar(place(room, 0, 0, 0))


def test_lamps_shine_on_a_state_of_which_only_the_kinematics_are_computed(room: mujoco.MjModel, fisheye: Fisheye):
    whole, kinematics = place(room, 0.5, 0.3, 1.0), mujoco.MjData(room)
    kinematics.qpos[:] = whole.qpos
    mujoco.mj_kinematics(room, kinematics)
    np.testing.assert_array_equal(fisheye.polar(kinematics), fisheye.polar(whole))
