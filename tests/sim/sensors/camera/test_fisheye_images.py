"""Images in deployment: light of sources adds up, exposure takes none of their order, a person is only drawn."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.errors import InputError
from sim.geometry import FreeSpace
from sim.recording.chunks import observe
from sim.robot.model import RADIUS_M
from sim.robot.world import RoomWorld
from sim.rooms.build import build_room
from sim.rooms.free_space import find_free_space
from sim.sensors.camera.faults import decode
from sim.sensors.camera.fisheye_images import PERSON_HEIGHT_M, PERSON_RADIUS_M, Persons, place_lamp
from sim.sensors.camera.illumination import (
    MAX_LIGHTS,
    TARGET_BRIGHTNESS,
    _set_lights,
    expose,
    find_sources,
    hang_lamp,
    mix,
)
from sim.settings import CameraSettings, DeploymentSettings, RoomSettings, SimSettings

ROOM = RoomSettings(kind="bedroom", width_m=3.6, depth_m=3.2, seed=3)
CAMERA = CameraSettings(rings=12, sectors=48, face_px=32)
POSES = np.array([(0.3, -0.2, 0.4), (-0.4, 0.1, 2.0)])
Draw = Callable[..., np.ndarray]


@pytest.fixture(scope="module")
def states() -> np.ndarray:
    return RoomWorld(SimSettings(room=ROOM, camera=CAMERA), drawn=False).rest_states(POSES)


@pytest.fixture(scope="module")
def draw(states: np.ndarray) -> Draw:
    def draw(**deployment: object) -> np.ndarray:
        use = DeploymentSettings.model_validate(deployment)
        return observe("fisheye", SimSettings(room=ROOM, camera=CAMERA, deployment=use), states)

    return draw


def test_lamps_and_windows_together_give_the_picture_as_it_is(draw: Draw):
    assert np.array_equal(draw(daylight=1.0), draw())


def test_light_of_sources_adds_up(draw: Draw):
    both, windows, lamps = draw(), draw(lamps=0.0, daylight=1.0), draw(daylight=0.0)
    for part in (windows, lamps):
        assert (part <= both).all() and decode(part).mean() < 0.9 * decode(both).mean()
    # each part is rounded to 8 bits; half a step of a code is at most 1 / 255 of its linear light's scale
    code = both.astype(int)
    step = decode(np.minimum(code + 1, 255).astype(np.uint8)) - decode(np.maximum(code - 1, 0).astype(np.uint8))
    assert (np.abs(decode(windows) + decode(lamps) - decode(both)) <= step + 1e-6).all()
    half = decode(draw(light=0.5, daylight=1.0)) - 0.5 * decode(both)
    assert (np.abs(half) <= step).all()


def test_windows_that_dim_change_some_places_more_than_others(draw: Draw):
    bright, dusk = decode(draw()), decode(draw(daylight=0.2))
    ratio = (dusk / np.maximum(bright, 1e-3))[bright > 0.05]
    assert ratio.max() > 1.5 * ratio.min()


@given(st.lists(st.floats(0.0, 2.0), min_size=4, max_size=4))
@settings(max_examples=20, deadline=None)
def test_a_mixture_is_linear_in_each_source(fraction: list[float]):
    rng = np.random.default_rng(0)
    light, lamps, windows = rng.uniform(0.05, 1.0, (3, 5, 7, 3))
    by, (a, b, c, d) = {"lamps": lamps, "windows": windows}, fraction
    one, other = mix(light, by, {"lamps": a, "windows": b}), mix(light, by, {"lamps": c, "windows": d})
    assert np.allclose(one + other, mix(light, by, {"lamps": a + c, "windows": b + d}))
    assert np.allclose(mix(light, by, {"lamps": 1.0, "windows": 1.0}), light)


def test_a_lamp_that_is_on_brightens_and_darkens_nothing(draw: Draw):
    plain, lit = draw(), draw(lamp_on=True)
    ball = (lit < plain).any(axis=-1)  # of the lamp itself, where something bright was behind it
    assert ball.mean() < 0.01 and decode(lit).mean() > 1.1 * decode(plain).mean()


def test_every_kind_of_room_has_lamps_and_all_but_a_labyrinth_have_windows():
    for kind in ("living_room", "office", "workshop", "labyrinth"):
        model = build_room(RoomSettings(kind=kind)).compile()
        lamps, windows = find_sources(model, "lamps"), find_sources(model, "windows")
        assert 1 <= len(lamps.place) <= MAX_LIGHTS and lamps.strength.sum() == pytest.approx(1.0)
        assert (len(windows.place) > 0) == (kind != "labyrinth")
        # a window shines into the room: towards its middle, which is the origin
        assert ((windows.facing * windows.place).sum(axis=1) < 0.0).all()
    assert hang_lamp(np.array([1.0, 2.0, 2.0])).place.tolist() == [[1.0, 2.0, 2.0]]


def test_daylight_needs_a_window(states: np.ndarray):
    labyrinth = RoomSettings(kind="labyrinth", width_m=3.0, depth_m=3.0)
    use = SimSettings(room=labyrinth, camera=CAMERA, deployment=DeploymentSettings(daylight=0.5))
    with pytest.raises(InputError, match=r"no window.*deployment\.daylight"):
        observe("fisheye", use, states)


@given(gain=st.floats(0.05, 1.0), balance=st.lists(st.floats(0.5, 1.0), min_size=3, max_size=3))
@settings(max_examples=20, deadline=None)
def test_automatic_exposure_undoes_gain_and_colour_of_the_light(gain: float, balance: list[float]):
    light = np.random.default_rng(0).uniform(0.02, 0.9, (2, 6, 16, 3)).astype(np.float32)
    seen = expose(light)
    assert np.allclose(seen.mean(axis=(1, 2)), TARGET_BRIGHTNESS, rtol=1e-4)
    assert np.allclose(expose(light * np.float32(gain) * np.array(balance, np.float32)), seen, rtol=1e-3)
    assert np.isfinite(expose(np.zeros((4, 8, 3), np.float32))).all()


def test_automatic_exposure_acts_on_images(draw: Draw):
    dim, auto = draw(light=0.2), draw(light=0.2, exposure="auto")
    assert auto.mean() > 1.3 * dim.mean()
    mean = decode(auto).mean(axis=(1, 2))
    assert np.ptp(mean, axis=1).max() < 0.05  # grey, but for what was cut off at white


@pytest.fixture(scope="module")
def floor() -> FreeSpace:
    return find_free_space(build_room(ROOM).compile(), PERSON_RADIUS_M, PERSON_HEIGHT_M)


def find_persons(persons: Persons, state: np.ndarray, floor: FreeSpace) -> np.ndarray:
    """Where persons are (n, 2) [m], by their heads; each has room, and none touches the robot."""
    places = np.array([shape.place[:2] for shape in persons.draw(state)[6::7]]).reshape(-1, 2)
    assert (np.linalg.norm(places - state[:2], axis=1) > PERSON_RADIUS_M + RADIUS_M).all()
    around = floor.cell_m * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
    assert floor.is_reachable(places[:, None] + around).any(axis=1).all(), "between cells, one of them"
    return places


def test_persons_stand_in_still_scenes_walk_while_the_robot_drives_and_stop_before_it(states, floor: FreeSpace):
    one, two, found, state = Persons(floor, 1, seed=1), Persons(floor, 2, seed=1), [], states[0].copy()
    for number in range(100):
        state[6] = number / 1e6  # another image at the same place
        found.append(find_persons(two, state, floor))
        assert np.array_equal(found[-1][:1], find_persons(one, state, floor)), "more persons move none"
    assert len(np.unique(np.concatenate(found).round(3), axis=0)) > 100
    drive = np.tile(states[0], (1200, 1))
    drive[:, 7:], drive[:, :2] = np.arange(0.5, 600.5, 0.5)[:, None], floor.origin - 10.0  # out of the way
    places = np.array([find_persons(two, state, floor) for state in drive])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    assert steps.max() <= 0.5 * 0.15 + 0.02 and 0.05 < (steps > 0.0).mean() < 0.95, "nobody jumps"
    assert np.array_equal(find_persons(Persons(floor, 2, seed=1), drive[-1], floor), places[-1])
    for state, place in zip(drive[::37], places[::37, 0], strict=True):
        state[:2] = place  # where a person would be
        find_persons(two, state, floor)


@pytest.mark.parametrize(("ceiling_m", "lamp_m"), [(None, 2.0), (3.0, 2.0), (1.85, 1.75)])
def test_a_lamp_hangs_where_a_person_has_room_and_below_the_ceiling(
    tmp_path: Path, ceiling_m: float | None, lamp_m: float
):
    ceiling = f'<geom type="box" size="2 2 .05" pos="0 0 {ceiling_m + 0.05}"/></worldbody>' if ceiling_m else ""
    (tmp_path / "room.xml").write_text(NARROW_ROOM.replace("</worldbody>", ceiling or "</worldbody>"))
    room = build_room(RoomSettings(mjcf=str(tmp_path / "room.xml")))
    room.delete(room.site("start"))
    model = room.compile()
    space = find_free_space(model, PERSON_RADIUS_M, PERSON_HEIGHT_M)
    place = place_lamp(space, model, 0)
    assert space.is_reachable(place[None, :2])[0]
    assert place[2] == pytest.approx(lamp_m)


def test_a_person_is_no_part_of_physics_or_free_space():
    plain = RoomWorld(SimSettings(room=ROOM, camera=CAMERA), drawn=False)
    use = DeploymentSettings(person=True, lamp_on=True, daylight=0.3, exposure="auto")
    changed = RoomWorld(SimSettings(room=ROOM, camera=CAMERA, deployment=use), drawn=False)
    assert changed.model.ngeom == plain.model.ngeom and np.array_equal(changed.state(), plain.state())
    assert np.array_equal(changed.free_space.reachable, plain.free_space.reachable)


NARROW_ROOM = """<mujoco><worldbody>
  <site name="start" pos="-1.3 0 0"/>
  <geom type="box" size="1.6 .05 1.2" pos="0 1.25 1.2"/><geom type="box" size="1.6 .05 1.2" pos="0 -1.25 1.2"/>
  <geom type="box" size=".05 1.3 1.2" pos="1.55 0 1.2"/><geom type="box" size=".05 1.3 1.2" pos="-1.55 0 1.2"/>
</worldbody></mujoco>"""


def test_a_person_needs_no_room_where_the_robot_starts(tmp_path: Path):
    (tmp_path / "narrow.xml").write_text(NARROW_ROOM)
    room = SimSettings(room=RoomSettings(mjcf=str(tmp_path / "narrow.xml")), camera=CAMERA)
    states = RoomWorld(room, drawn=False).rest_states(np.zeros((1, 3)))
    use = DeploymentSettings.model_validate({"person": True})
    seen = observe("fisheye", room.model_copy(update={"deployment": use}), states)
    assert not np.array_equal(seen, observe("fisheye", room, states))


@pytest.mark.parametrize("source", ["lamps", "windows"])
def test_a_room_without_materials_has_no_sources(source: Literal["lamps", "windows"]):
    model = mujoco.MjModel.from_xml_string(NARROW_ROOM)
    assert model.nmat == 0
    assert not len(find_sources(model, source).geoms)


OWN_ROOM = """<mujoco><asset>
  <texture name="sky" type="2d" builtin="flat" width="2" height="2" rgb1="1 1 1"/>
  <material name="pane" texture="sky" emission="1"/><material name="glow" emission="1"/>
</asset><worldbody>
  <geom name="left" type="box" size="0.02 0.6 0.5" pos="-2 0 1.2" material="pane"/>
  <geom name="right" type="box" size="0.02 0.6 0.5" pos="2 0 1.2" material="pane"/>
  <geom type="sphere" size="0.1" pos="-1 0 2" material="glow"/>
  <geom type="plane" size="0.5 0.5 0.1" pos="1 0 2" material="glow"/>
</worldbody></mujoco>"""


def test_lamps_and_windows_fixed_to_the_world_are_lights_of_their_own():
    model = mujoco.MjModel.from_xml_string(OWN_ROOM)
    lamps, windows = find_sources(model, "lamps"), find_sources(model, "windows")
    assert sorted(lamps.place[:, 0]) == [-1.0, 1.0] and lamps.strength.min() > 0.01
    assert np.allclose(np.abs(windows.facing), [1.0, 0.0, 0.0]), "a pane shines where it is thinnest"
    assert (windows.facing[:, 0] * windows.place[:, 0] < 0.0).all(), "into the room"


def test_where_nothing_shines_no_light_is_scattered():
    model = mujoco.MjModel.from_xml_string(NARROW_ROOM)
    scene = mujoco.MjvScene(model, 10)
    _set_lights(scene, find_sources(model, "windows"))
    assert not any(light.ambient.any() or light.diffuse.any() for light in scene.lights[: scene.nlight])
