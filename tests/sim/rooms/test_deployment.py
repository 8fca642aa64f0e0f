"""A room that has changed: light that only dims, furniture that is pushed only where it can be."""

import mujoco
import numpy as np
import pytest

from sim.errors import InputError
from sim.robot.world import RoomWorld
from sim.rooms.build import build_room
from sim.rooms.deployment import GAMMA, MOVABLE_KINDS, move_furniture
from sim.rooms.free_space import collides
from sim.rooms.spec import freeze
from sim.sensors.camera.faults import decode
from sim.sensors.camera.fisheye import Fisheye
from sim.settings import CameraSettings, DeploymentSettings, RoomSettings, SimSettings

ROOM = RoomSettings(kind="office", width_m=4.0, depth_m=3.5, seed=2)
CAMERA = CameraSettings(rings=16, sectors=64, face_px=32)


def draw(use: DeploymentSettings) -> np.ndarray:
    world = RoomWorld(SimSettings(room=ROOM, camera=CAMERA, deployment=use))
    world.place(np.array((0.3, -0.2, 0.4)))  # it need not be free to look
    with Fisheye(world.model, CAMERA) as fisheye:
        return fisheye.polar(world.data).astype(int)


def test_dimmed_light_brightens_no_pixel():
    bright = draw(DeploymentSettings())
    half, dark = draw(DeploymentSettings(light=0.5)), draw(DeploymentSettings(light=0.0))
    lamps, no_lamps = draw(DeploymentSettings(lamps=0.5)), draw(DeploymentSettings(lamps=0.0))
    assert dark.max() == 0
    for brighter, dimmer in ((bright, half), (bright, lamps), (lamps, no_lamps), (no_lamps, dark)):
        assert (dimmer <= brighter).all()
        assert dimmer.mean() < 0.95 * brighter.mean()
    # all light alike, but for what was cut off at white, before its texture was laid over it
    code = 0.5 ** (1 / GAMMA)
    assert (half >= code * bright - 2).all()
    assert np.mean(half <= code * bright + 2) > 0.97
    light = decode(half.astype(np.uint8)).mean() / decode(bright.astype(np.uint8)).mean()
    assert light == pytest.approx(0.5, abs=0.03)


def test_lamps_go_out_and_windows_stay():
    spec = build_room(ROOM)
    model = RoomWorld(SimSettings(room=ROOM, deployment=DeploymentSettings(lamps=0.0))).model
    before = {material.name: (material.emission, any(material.textures)) for material in spec.materials}
    glowing = {name: pictured for name, (emission, pictured) in before.items() if emission > 0}
    assert set(glowing.values()) == {True, False}
    for name, pictured in glowing.items():
        assert model.mat_emission[model.material(name).id] == pytest.approx(before[name][0] if pictured else 0.0)
    assert not model.light_diffuse.any()


@pytest.mark.parametrize("moved_m", [0.2, 0.8])
def test_pieces_are_pushed_by_so_much_or_not_at_all_and_touch_nothing_new(moved_m: float):
    room = freeze(build_room(ROOM))
    moved = move_furniture(room, moved_m, 0)
    way = {body.name: np.linalg.norm(moved.body(body.name).pos - body.pos) for body in room.bodies}
    pushed = {name for name, m in way.items() if m > 0}
    assert pushed
    assert all(name.rpartition("_")[0] in MOVABLE_KINDS for name in pushed)
    assert [way[name] for name in pushed] == pytest.approx([moved_m] * len(pushed))
    before, after = (count_overlaps(spec.compile()) for spec in (room, moved))
    assert all(depth > before.get(pair, 0.0) - 1e-6 for pair, depth in after.items())


def count_overlaps(model: mujoco.MjModel) -> dict[tuple[int, int], float]:
    """Depths [m], negative, of all pairs of geoms of different bodies that reach into each other."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = np.flatnonzero(collides(model) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)).tolist()
    pairs = [(a, b) for a in solid for b in solid if a < b and model.geom_bodyid[a] != model.geom_bodyid[b]]
    depth = {pair: mujoco.mj_geomDistance(model, data, *pair, 0.0, None) for pair in pairs}
    return {pair: value for pair, value in depth.items() if value < 0}


def test_the_same_seed_pushes_the_same_way_and_the_room_itself_stays():
    room = freeze(build_room(ROOM))
    places = [body.pos.copy() for body in room.bodies]
    one, again, other = (move_furniture(room, 0.3, seed) for seed in (0, 0, 1))
    stay = [np.array_equal(body.pos, place) for body, place in zip(room.bodies, places, strict=True)]
    assert all(stay)
    assert all(np.array_equal(a.pos, b.pos) for a, b in zip(one.bodies, again.bodies, strict=True))
    assert not all(np.array_equal(a.pos, b.pos) for a, b in zip(one.bodies, other.bodies, strict=True))


def test_a_piece_that_is_shut_in_stays():
    spec = mujoco.MjSpec()
    chair = spec.worldbody.add_body(name="chair_0")
    chair.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.2, 0.2, 0.4))
    for number, (x, y) in enumerate(((0.35, 0), (-0.35, 0), (0, 0.35), (0, -0.35))):
        wall = spec.worldbody.add_body(name=f"wall_{number}", pos=(x, y, 0))
        wall.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.5, 1) if x else (0.5, 0.1, 1))
    # far enough to stand beyond the walls, where nothing is: but they are in the way
    with pytest.raises(
        InputError, match=r"deployment\.moved_m 1\.5: the room has no small piece that can be pushed so far"
    ):
        move_furniture(spec, 1.5, 0)
    spec.worldbody.add_body(name="stool_0", pos=(9, 9, 0)).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.1, 1))
    moved = move_furniture(spec, 1.5, 0)
    assert np.array_equal(moved.body("chair_0").pos, np.zeros(3))
    assert np.hypot(*moved.body("stool_0").pos[:2] - 9) == pytest.approx(1.5)
    for number in range(4):
        spec.delete(spec.body(f"wall_{number}"))
    assert np.hypot(*move_furniture(spec, 1.5, 0).body("chair_0").pos[:2]) == pytest.approx(1.5)
