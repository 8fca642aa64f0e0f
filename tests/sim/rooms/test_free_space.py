import mujoco
import numpy as np
import pytest

from sim.errors import InputError
from sim.rooms.free_space import find_free_space

RADIUS_M, HEIGHT_M = 0.105, 0.37
BOX, PLANE, CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_CYLINDER


def _hall(width_m: float = 7.0, depth_m: float = 4.3, floor: bool = True) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    if floor:
        spec.worldbody.add_geom(name="floor", type=PLANE, size=(0, 0, 1))
    w, d = width_m / 2, depth_m / 2
    for pos, size in (
        ((w + 0.1, 0, 1), (0.1, d + 0.2, 1)),
        ((-w - 0.1, 0, 1), (0.1, d + 0.2, 1)),
        ((0, d + 0.1, 1), (w, 0.1, 1)),
        ((0, -d - 0.1, 1), (w, 0.1, 1)),
    ):
        spec.worldbody.add_geom(type=BOX, pos=pos, size=size)
    return spec


def _cells(space) -> np.ndarray:
    rows, columns = space.free.shape
    row, column = np.mgrid[0:rows, 0:columns]
    return space.origin + np.stack((column, row), axis=-1) * space.cell_m


def test_an_empty_room_is_free_up_to_the_radius_from_its_walls():
    space = find_free_space(_hall().compile(), RADIUS_M, HEIGHT_M)
    points = _cells(space)
    inner = (np.abs(points[..., 0]) < 3.5 - RADIUS_M) & (np.abs(points[..., 1]) < 2.15 - RADIUS_M)
    assert np.array_equal(space.reachable, inner)
    assert space.shorter_side_m == pytest.approx(4.3, abs=0.02)
    assert np.array_equal(space.free[space.reachable], np.ones(space.reachable.sum(), bool))
    assert space.is_reachable(space.start)


def test_boxes_agree_with_the_analytic_distance_to_a_rectangle():
    rng = np.random.default_rng(3)
    spec, boxes = _hall(), []
    for _ in range(40):
        middle, half, turn = rng.uniform((-3.3, -2), (3.3, 2)), rng.uniform(0.02, 0.4, 2), rng.uniform(0, np.pi)
        z, tall = rng.uniform(0.0, 0.7), rng.uniform(0.01, 0.2)
        quat = (np.cos(turn / 2), 0, 0, np.sin(turn / 2))
        spec.worldbody.add_geom(type=BOX, pos=(*middle, z), size=(*half, tall), quat=quat)
        if z - tall < HEIGHT_M and z + tall > 0.005:
            boxes.append((middle, half, turn))
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)
    points = _cells(space)
    clearance = np.minimum(3.5 - np.abs(points[..., 0]), 2.15 - np.abs(points[..., 1]))
    within = clearance > 0
    for middle, half, turn in boxes:
        away = points - middle
        c, s = np.cos(turn), np.sin(turn)
        own = np.abs(np.stack((c * away[..., 0] + s * away[..., 1], c * away[..., 1] - s * away[..., 0]), -1))
        clearance = np.minimum(clearance, np.linalg.norm(np.maximum(own - half, 0), axis=-1))
    sure = within & (np.abs(clearance - RADIUS_M) > 1e-6)
    assert len(boxes) > 10
    assert np.array_equal(space.free[sure], (clearance > RADIUS_M)[sure])


def test_every_shape_agrees_with_contacts_of_a_real_cylinder():
    """MuJoCo's own collision detection, at random places, in a model with the cylinder as a moving body."""
    rng = np.random.default_rng(5)
    spec = _hall(4.0, 3.0)
    spec.add_mesh(name="wedge", uservert=[0, 0, 0, 0.6, 0, 0, 0, 0.5, 0, 0, 0, 0.7, 0.6, 0, 0.2])
    tilt = (0.9, 0.3, 0.2, 0.1)
    world = spec.worldbody
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=(-1.2, 0.8, 0.5), size=(0.3, 0, 0))
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, pos=(-1.2, -0.6, 0.2), size=(0.1, 0.3, 0), quat=tilt)
    world.add_geom(type=CYLINDER, pos=(0.2, 0.7, 0.2), size=(0.25, 0.1, 0), quat=tilt)
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, pos=(1.3, 0.8, 0.2), size=(0.4, 0.2, 0.15), quat=tilt)
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="wedge", pos=(0.9, -0.9, 0.0))
    world.add_geom(type=BOX, pos=(0.0, -0.7, 0.25), size=(0.3, 0.1, 0.1), quat=tilt)
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)

    reach = HEIGHT_M - 0.005
    probe = world.add_body(name="probe")
    probe.add_freejoint()
    probe.add_geom(name="probe", type=CYLINDER, size=(RADIUS_M, reach / 2, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    probe_id = model.geom("probe").id
    cells = _cells(space)[space.free | ~space.free].reshape(-1, 2)
    inside = (np.abs(cells[:, 0]) < 1.9) & (np.abs(cells[:, 1]) < 1.4)
    wrong = 0
    for x, y in rng.permutation(cells[inside])[:1500]:
        data.qpos[:] = (x, y, 0.005 + reach / 2, 1, 0, 0, 0)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        touching = any(
            contact.dist < 0 and probe_id in (contact.geom1, contact.geom2) for contact in data.contact[: data.ncon]
        )
        wrong += touching == bool(space.is_free(np.array((x, y))))
    # Depths near zero differ by the collision detector's own tolerance.
    assert wrong <= 2


def test_a_table_blocks_with_its_legs_and_a_low_one_with_its_top():
    spec = _hall()
    for x, top in ((-1.5, 0.74), (1.5, 0.36)):
        spec.worldbody.add_geom(type=BOX, pos=(x, 0, top), size=(0.5, 0.4, 0.02))
        spec.worldbody.add_geom(type=BOX, pos=(x - 0.45, 0, top / 2), size=(0.03, 0.03, top / 2))
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)
    assert space.is_reachable(np.array((-1.4, 0.0)))
    assert not space.is_free(np.array((-1.95, 0.0)))
    assert not space.is_free(np.array((1.6, 0.0)))
    taller = find_free_space(spec.compile(), RADIUS_M, 0.8)
    assert not taller.is_free(np.array((-1.4, 0.0)))


def test_thin_rugs_and_drawn_only_geoms_block_nothing():
    spec = _hall()
    spec.worldbody.add_geom(type=BOX, pos=(0, 0, 0.002), size=(1, 1, 0.002))
    spec.worldbody.add_geom(type=BOX, pos=(2, 0, 0.2), size=(0.3, 0.3, 0.2), contype=0, conaffinity=0)
    bare = find_free_space(_hall().compile(), RADIUS_M, HEIGHT_M)
    assert np.array_equal(find_free_space(spec.compile(), RADIUS_M, HEIGHT_M).free, bare.free)


def test_planes_enclose_a_room_as_walls_do():
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="floor", type=PLANE, size=(0, 0, 1))
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        # A quarter turn about (y, -x, 0), so that its normal looks into the room
        quat = (np.sqrt(0.5), np.sqrt(0.5) * y, -np.sqrt(0.5) * x, 0)
        spec.worldbody.add_geom(type=PLANE, size=(2, 2, 0.1), pos=(2 * x, 1.5 * y, 1), quat=quat)
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)
    assert space.shorter_side_m == pytest.approx(3.0, abs=0.02)


def test_a_terrain_blocks_where_it_rises():
    spec = _hall(4.0, 3.0)
    height = np.zeros((21, 21))
    height[8:13, 8:13] = 1.0
    spec.add_hfield(name="hill", nrow=21, ncol=21, size=(1, 1, 0.3, 0.1), userdata=height.ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="hill")
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M, cell_m=0.04)
    assert not space.is_free(np.array((0.0, 0.0)))
    assert not space.is_free(np.array((0.28, 0.0)))
    assert space.is_reachable(np.array((0.6, 0.0)))


def test_the_outside_of_a_small_room_does_not_win():
    spec = _hall(2.0, 2.0)
    spec.worldbody.add_geom(type=BOX, pos=(8, 8, 0.5), size=(0.1, 0.1, 0.5))
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M, cell_m=0.05)
    assert np.abs(_cells(space)[space.reachable]).max() < 1.0


def test_the_start_site_chooses_the_room_and_must_be_free():
    spec = _hall(6.0, 3.0)
    spec.worldbody.add_geom(type=BOX, pos=(1.0, 0, 1), size=(0.1, 1.5, 1))
    assert find_free_space(spec.compile(), RADIUS_M, HEIGHT_M).start[0] < 1.0
    site = spec.worldbody.add_site(name="start", pos=(2.0, 0.3, 0))
    space = find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)
    assert np.allclose(space.start, (2.0, 0.3))
    assert not space.is_reachable(np.array((-1.0, 0.0)))
    site.pos = (1.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"^room: the site start at \(1, 0\) m is not free for the robot$"):
        find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)
    site.pos = (3.34, 0.0, 0.0)
    with pytest.raises(InputError, match="the free space about the site start is not enclosed"):
        find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)


def test_what_nothing_encloses_is_refused():
    spec = _hall()
    spec.delete(spec.geoms[1])
    with pytest.raises(InputError, match=r"^room: no free space is enclosed by walls$"):
        find_free_space(spec.compile(), RADIUS_M, HEIGHT_M)
    bare = mujoco.MjSpec()
    bare.worldbody.add_geom(name="floor", type=PLANE, size=(0, 0, 1))
    with pytest.raises(InputError, match="nothing stands on the floor"):
        find_free_space(bare.compile(), RADIUS_M, HEIGHT_M)
    with pytest.raises(InputError, match="is too large: at most"):
        find_free_space(_hall(300, 300).compile(), RADIUS_M, HEIGHT_M)
