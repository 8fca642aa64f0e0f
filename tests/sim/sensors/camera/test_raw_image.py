"""Faults of the round image: glare adds light around lamps alone, a JPEG file has its size, unwrapping adds nothing."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.recording.chunks import observe
from sim.robot.world import RoomWorld
from sim.sensors.camera.faults import BRIGHT_LIGHT, FACE_PX, add_glare, compress
from sim.settings import SimSettings
from tests.helpers.recordings import change


@given(st.floats(0.0, 1.0), st.integers(20, 219), st.integers(20, 219))
@settings(max_examples=20, deadline=None)
def test_glare_adds_light_most_close_to_a_lamp_and_in_proportion(glare: float, row: int, column: int):
    away = np.hypot(*(np.indices((240, 240)) - np.array([row, column])[:, None, None]))
    light = np.where(away[..., None] < 6.0, 1.0, BRIGHT_LIGHT - 0.1).astype(np.float32).repeat(3, axis=2)
    added, all_of_it = (add_glare(light, strength, 1.25) - light for strength in (glare, 1.0))
    assert (added >= 0.0).all() and np.allclose(added, glare * all_of_it, atol=1e-4)
    near, far, farthest = (all_of_it[(away > a) & (away < b)].mean() for a, b in ((6, 9), (20, 25), (60, 70)))
    assert near > 10 * far > 15 * farthest > 0.0
    dim = np.minimum(light, BRIGHT_LIGHT - 0.01, dtype=np.float32)
    np.testing.assert_array_equal(add_glare(dim, 1.0, 1.25), dim)


def test_a_jpeg_file_is_as_large_as_it_may_be_and_a_larger_one_is_closer_to_the_image():
    rng, errors = np.random.default_rng(0), []
    soft = cv2.resize(rng.uniform(0, 255, (12, 12, 3)), (480, 480))
    picture = np.clip(soft + rng.normal(0, 6, (*soft.shape[:2], 1)), 0, 255).astype(np.uint8)
    for jpeg_kb in (0.1, 8.0, 10.0, 20.0, 60.0, 1000.0):
        file = compress(picture, jpeg_kb)
        assert 0.85 * jpeg_kb < len(file) / 1000 <= jpeg_kb or jpeg_kb in (0.1, 1000.0)
        errors.append(np.abs(np.asarray(cv2.imdecode(file, cv2.IMREAD_COLOR))[..., ::-1] - 1.0 * picture).mean())
    assert errors == sorted(errors, reverse=True) and errors[-1] < 1.5


def test_rendered_faults_change_images_always_in_the_same_way_and_unwrapping_adds_nothing(small_settings: SimSettings):
    room = change(small_settings, camera={"face_px": FACE_PX, "rings": 32, "sectors": 128})
    robot = RoomWorld(room, drawn=False)
    states = robot.rest_states(np.array([(*robot.free_space.start, 0.3)]))  # where windows and lamps are seen

    def draw(**faults: float) -> np.ndarray:
        return observe("fisheye", change(room, image_faults=faults), states).astype(int)

    plain, whole = draw(), draw(jpeg_kb=1000.0)
    assert np.abs(plain - whole)[:, :-1].mean() < 1.0
    assert abs((plain - whole)[:, -1].mean()) < 4.0, "half a pixel of the last ring is the black around the image"
    glaring, coarse = draw(glare=0.1), draw(jpeg_kb=10.0)
    assert np.abs(glaring - plain).mean() > 1.0 and np.abs(coarse - plain).mean() > 2.0
    assert np.array_equal(glaring, draw(glare=0.1)) and np.array_equal(coarse, draw(jpeg_kb=10.0))
