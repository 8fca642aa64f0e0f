"""Rooms whose places look alike: what repeats on walls and ceiling, and furniture with twins."""

import mujoco
import numpy as np

from sim.rooms.build import build_room
from sim.rooms.furniture import textures
from sim.rooms.placement import MOTIF_M, PX_PER_M, repeat
from sim.settings import RoomSettings


def texture_of(model: mujoco.MjModel, body: int) -> bytes | None:
    """The picture on the first geom of a body; None: it has none."""
    material = model.geom_matid[model.body_geomadr[body]]
    texture = model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]
    if texture < 0:
        return None
    start = model.tex_adr[texture]
    return model.tex_data[start : start + model.tex_height[texture] * model.tex_width[texture] * 3].tobytes()


def shape_of(model: mujoco.MjModel, body: int) -> bytes:
    """Places and sizes of a body's geoms, in its own frame."""
    geoms = np.flatnonzero(model.geom_bodyid == body)
    return np.hstack([model.geom_pos[geoms], model.geom_size[geoms]]).tobytes()


def build(look_alike: bool) -> mujoco.MjModel:
    return build_room(RoomSettings(kind="office", seed=3, look_alike=look_alike)).compile()


def twins(model: mujoco.MjModel) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for body in range(1, model.nbody):
        found.setdefault(model.body(body).name.rsplit("_", 1)[0], []).append(body)
    return {kind: several for kind, several in found.items() if len(several) > 1 and kind not in ("wall", "rug")}


def test_pieces_of_one_name_are_the_same() -> None:
    alike = build(True)
    assert {"desk", "office_chair", "picture", "lamp", "window", "filing_cabinet"} <= set(twins(alike))
    for kind, several in twins(alike).items():
        assert len({shape_of(alike, body) for body in several}) == 1, kind
        assert len({texture_of(alike, body) for body in several}) == 1, kind


def test_without_it_they_differ() -> None:
    usual = build(False)
    assert len({texture_of(usual, body) for body in twins(usual)["picture"]}) > 1
    assert "filing_cabinet" not in twins(usual)


def test_all_walls_have_one_motif_that_repeats() -> None:
    model = build_room(RoomSettings(kind="bedroom", look_alike=True, width_m=5.0, depth_m=4.0)).compile()
    period = round(MOTIF_M * PX_PER_M)
    for number in range(4):
        body = model.body(f"wall_{number}").id
        texture = model.mat_texid[model.geom_matid[model.body_geomadr[body]], mujoco.mjtTextureRole.mjTEXROLE_RGB]
        rows, columns, start = model.tex_height[texture], model.tex_width[texture], model.tex_adr[texture]
        image = model.tex_data[start : start + rows * columns * 3].reshape(rows, columns, 3)
        assert image[:period, :period].std() > 3.0
        np.testing.assert_array_equal(image[:, period:], image[:, :-period])
        np.testing.assert_array_equal(image[period:], image[:-period])


def test_a_motif_has_no_seams_and_is_repeated_to_the_size_of_its_wall() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        image = textures.motif(rng, (40, 40), textures.muted(rng), textures.muted(rng)).astype(float)
        for axis in (0, 1):
            steps = np.abs(np.diff(image, axis=axis)).max()
            assert np.abs(np.take(image, 0, axis) - np.take(image, -1, axis)).max() <= steps
    for width, height in ((0.01, 3.0), (1.0, 1.0), (7.3, 2.6)):
        image = repeat(np.zeros((30, 30, 3), np.uint8), (width, height))
        assert image.shape == (max(round(60 * height), 8), max(round(60 * width), 8), 3)
