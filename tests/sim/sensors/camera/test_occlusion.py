"""What walls hide: an image is the same as one of everything, byte for byte."""

import mujoco
import numpy as np
import pytest

from sim.robot.world import RoomWorld
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.occlusion import Occlusion
from sim.settings import CameraSettings, RoomSettings, SimSettings

SMALL_FLAT = {"kind": "flat", "width_m": 7.0, "depth_m": 7.3}


def draw_places(world: RoomWorld, count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    row, column = np.nonzero(world.free_space.reachable)
    chosen = rng.integers(len(row), size=count)
    points = world.free_space.origin + world.free_space.cell_m * np.stack([column, row], axis=1)[chosen]
    return world.rest_states(np.column_stack([points, rng.uniform(-np.pi, np.pi, count)]))


@pytest.mark.parametrize(
    ("room", "hides"),
    [
        (SMALL_FLAT, 0.4),
        ({"kind": "labyrinth", "width_m": 5.0, "depth_m": 4.0}, 0.3),
        ({"kind": "bedroom", "shape": "u"}, 0.0),
        *(pytest.param({"kind": "flat", "seed": seed}, 0.5, marks=pytest.mark.slow) for seed in range(4)),
        pytest.param({"kind": "corridor"}, 0.5, marks=pytest.mark.slow),
    ],
)
def test_no_image_changes(room: dict, hides: float, monkeypatch: pytest.MonkeyPatch) -> None:
    world = RoomWorld(SimSettings(room=RoomSettings.model_validate(room)))
    camera = CameraSettings(face_px=192, rings=64, sectors=256)
    drawn, hidden = np.flatnonzero(world.model.geom_group <= 2), []
    with Fisheye(world.model, camera) as culled, Fisheye(world.model, camera) as full:
        occlusion = Occlusion(world.model)
        for state in draw_places(world, 25):
            world.data.qpos[:] = state
            mujoco.mj_kinematics(world.model, world.data)
            image = culled.polar(world.data)
            with monkeypatch.context() as patch:
                patch.setattr(Occlusion, "find_hidden", lambda *_: np.zeros(world.model.ngeom, bool))
                np.testing.assert_array_equal(full.polar(world.data), image)
            hidden.append(occlusion.find_hidden(world.data.site("robot/camera").xpos)[drawn].mean())
    assert np.mean(hidden) >= hides
    assert (world.model.geom_group[drawn] <= 2).all()


def hides_ball(alpha: float = 1.0, top_m: float = 2.5, turn_rad: float = 0.0, camera: tuple = (-1.0, 0.0, 0.2)) -> bool:
    """Whether a wall at x = 0 in a room hides a ball at x = 1 from a camera."""
    spec = mujoco.MjSpec()
    kind, world = mujoco.mjtGeom, spec.worldbody
    for x, y, w, d in ((2, 0, 0.1, 2), (-2, 0, 0.1, 2), (0, 2, 2, 0.1), (0, -2, 2, 0.1)):
        world.add_geom(type=kind.mjGEOM_BOX, pos=(x, y, 1.25), size=(w, d, 1.25))
    quat = (np.cos(turn_rad / 2), 0, 0, np.sin(turn_rad / 2))
    size, colour = (0.05, 0.6, top_m / 2), (1, 1, 1, alpha)
    world.add_geom(type=kind.mjGEOM_BOX, pos=(0, 0, top_m / 2), size=size, rgba=colour, quat=quat)
    world.add_geom(name="ball", type=kind.mjGEOM_SPHERE, pos=(1, 0, 0.5), size=(0.1, 0, 0))
    model = spec.compile()
    return bool(Occlusion(model).find_hidden(np.array(camera))[model.geom("ball").id])


def test_only_an_opaque_wall_of_full_height_along_the_axes_hides() -> None:
    assert hides_ball()
    assert not hides_ball(alpha=0.5)
    assert not hides_ball(top_m=2.0)
    assert not hides_ball(turn_rad=0.3)
    assert not hides_ball(camera=(-1.0, 0.0, 2.6))
    assert not hides_ball(camera=(-0.06, 0.0, 0.2))
    assert not hides_ball(camera=(0.5, 0.0, 0.2))


def test_a_ball_comes_into_view_beside_the_end_of_a_wall() -> None:
    places = np.linspace(0.0, 1.85, 75)
    seen = [not hides_ball(camera=(-1.0, float(y), 0.2)) for y in places]
    first = seen.index(True)
    assert all(seen[first:])
    # a ray from 1.2 past the end of the wall meets its middle, one from 1.0 its edge
    assert 0.9 < places[first] < 1.2
