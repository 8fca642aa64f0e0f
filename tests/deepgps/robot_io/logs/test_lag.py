"""The lag of the wheels after the images, from turns that both see."""

import numpy as np
import pytest

from deepgps.robot_io.logs.lag import Pairs, choose_lag, estimate_lag, judge_pairs, measure_shift
from sim.errors import InputError
from tests.helpers.robot_log import make_motion, make_texture


def see(lag_s: float, sign: float = 1.0, scale: float = 1.0) -> tuple[Pairs, np.ndarray, np.ndarray]:
    """Pairs of images a fifth of a second apart, and the heading by wheels that come late, mirrored or scaled."""
    motion, rng = make_motion(), np.random.default_rng(0)
    first_s = np.arange(0.5, motion.time_s[-1] - 1.0, 0.1)
    yaw = [np.interp(time_s, motion.time_s, motion.pose[:, 2]) for time_s in (first_s, first_s + 0.2)]
    turned = sign * (yaw[1] - yaw[0]) + rng.normal(0.0, 0.005, len(first_s))
    return Pairs(first_s, first_s + 0.2, turned), motion.time_s + lag_s, scale * motion.pose[:, 2]


def test_the_lag_is_measured_from_turns():
    for lag_s in (-0.3, 0.0, 0.05, 0.4):
        lag = estimate_lag(*see(lag_s))
        assert lag is not None and abs(lag.seconds - lag_s) < 0.008 and lag.agree > 0.95
        seconds, notes = choose_lag("estimate", lag)
        assert seconds == lag.seconds and "ms later than the images" in notes[0]
        assert choose_lag(lag_s, lag) == (lag_s, []) and "the turns show" in choose_lag(lag_s + 0.1, lag)[1][0]


def test_images_that_turn_otherwise_are_refused_and_few_show_no_lag():
    for how, message in (({"sign": -1.0}, "turn against the wheels"), ({"scale": 180 / np.pi}, "angles in radians")):
        with pytest.raises(InputError, match=message):
            choose_lag("estimate", estimate_lag(*see(0.05, **how)))
    pairs, time_s, yaw = see(0.05)
    assert estimate_lag(Pairs(*(part[:20] for part in pairs)), time_s, yaw) is None
    with pytest.raises(InputError, match="fewer than 12 pairs"):
        choose_lag("estimate", None)


def test_the_shift_of_two_images_is_the_turn_between_them():
    polar = make_texture()[:16, :64]
    for sectors in (0, 5, -9):
        turned = measure_shift(polar, np.roll(polar, -sectors, axis=1))
        assert turned == pytest.approx(sectors * 2 * np.pi / 64, abs=1e-6)


def test_images_that_turn_without_the_wheels_are_refused_or_noted_with_figures():
    pairs, time_s, yaw = see(0.0)
    none = Pairs(*(part[:0] for part in pairs))
    with pytest.raises(InputError, match=r"images turn by \d{3,} deg in \d+ of \d+ pairs, and the wheels never differ"):
        judge_pairs(none, pairs, time_s, 0.02 * np.sin(yaw), time_s, "/camera")
    rest = Pairs(pairs.first_s, pairs.second_s, 0.01 * np.sin(pairs.first_s))
    assert judge_pairs(pairs, rest, time_s, yaw, time_s, "/camera") == []
    assert judge_pairs(none, rest, time_s, 0.0 * yaw, time_s, "/camera") == []
    moved = rest._replace(turned=rest.turned + 0.2 * (np.arange(len(rest.turned)) % 3 == 0))
    after = moved._replace(first_s=moved.first_s + 1e4, second_s=moved.second_s + 1e4)
    (note,) = judge_pairs(pairs, after, time_s, yaw, time_s, "/camera")
    assert "in 33% of " in note and "while the wheels do not turn, images do, by" in note


@pytest.mark.parametrize(("wheel", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_wheel_that_counts_backward_is_named(wheel: str, sign: float):
    """What is a turn is a drive by the wheels, and the other way round."""
    pairs, time_s, yaw = see(0.0)
    still = pairs._replace(turned=0.001 * np.cos(pairs.first_s))
    with pytest.raises(InputError, match=rf"one of them counts backward, by the images the {wheel} one"):
        judge_pairs(still, pairs, time_s, 3.0 * time_s, sign * yaw, "/camera")
