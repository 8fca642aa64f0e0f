"""The lag of the wheels after the images, from turns that both see."""

import numpy as np
import pytest

from deepgps.robot_io.logs.lag import Pairs, estimate_lag, judge_pairs
from sim.errors import InputError
from tests.helpers.robot_log import make_motion


def see(lag_s: float, sign: float = 1.0, scale: float = 1.0) -> tuple[Pairs, np.ndarray, np.ndarray]:
    """Pairs of images a fifth of a second apart, and the heading by wheels that come late, mirrored or scaled."""
    motion, rng = make_motion(), np.random.default_rng(0)
    first_s = np.arange(0.5, motion.time_s[-1] - 1.0, 0.1)
    yaw = [np.interp(time_s, motion.time_s, motion.pose[:, 2]) for time_s in (first_s, first_s + 0.2)]
    turned = sign * (yaw[1] - yaw[0]) + rng.normal(0.0, 0.005, len(first_s))
    return (
        Pairs(first_s, first_s + 0.2, turned, np.ones(len(turned), bool)),
        motion.time_s + lag_s,
        scale * motion.pose[:, 2],
    )


def judge(
    pairs: Pairs, time_s: np.ndarray, yaw: np.ndarray, given: float | str = "estimate"
) -> tuple[float, list[str]]:
    return judge_pairs(pairs, time_s, yaw, time_s, given, "/camera")


def beside(pairs: Pairs, others: Pairs, turned: np.ndarray) -> Pairs:
    """The pairs, and others that are in no turn, in which images turn by some angles."""
    others = others._replace(turned=turned, in_turn=np.zeros(len(turned), bool))
    return Pairs(*map(np.concatenate, zip(pairs, others, strict=True)))


def test_the_lag_is_measured_from_turns():
    for lag_s in (-0.3, 0.0, 0.05, 0.4):
        seconds, notes = judge(*see(lag_s))
        assert abs(seconds - lag_s) < 0.008 and "ms later than the images" in notes[-1]
        lag = estimate_lag(*see(lag_s))
        assert lag is not None and lag.agree > 0.95
    assert judge(*see(0.05), given=0.05) == (0.05, [])
    assert "the turns show 0.0" in judge(*see(0.05), given=0.15)[1][0]


def test_images_that_turn_otherwise_are_refused_and_few_show_no_lag():
    for how, message in (({"sign": -1.0}, "turn against the wheels"), ({"scale": 180 / np.pi}, "angles in radians")):
        with pytest.raises(InputError, match=message):
            judge(*see(0.05, **how))
    pairs, time_s, yaw = see(0.05)
    few = Pairs(*(part[:20] for part in pairs))
    assert judge(few, time_s, yaw, 0.1) == (0.1, [])
    with pytest.raises(InputError, match="fewer than 12 pairs"):
        judge(few, time_s, yaw)


def test_images_that_turn_without_the_wheels_are_refused_or_noted_with_figures():
    pairs, time_s, yaw = see(0.0)
    none, rest = Pairs(*(part[:0] for part in pairs)), 0.01 * np.sin(pairs.first_s)
    with pytest.raises(InputError, match=r"images turn by \d{3,} deg in \d+ of \d+ pairs, and the wheels never differ"):
        judge(beside(none, pairs, pairs.turned), time_s, 0.02 * np.sin(yaw), 0.0)
    assert judge(beside(pairs, pairs, rest), time_s, yaw, 0.0) == (0.0, [])
    assert judge(beside(none, pairs, rest), time_s, 0.0 * yaw, 0.0) == (0.0, [])
    frozen = pairs._replace(turned=pairs.turned * (pairs.first_s < 15.0))
    assert "while the wheels turn, images do not turn, first at 1" in judge(frozen, time_s, yaw, 0.0)[1][0]
    after = pairs._replace(first_s=pairs.first_s + 1e4, second_s=pairs.second_s + 1e4)
    _, (note,) = judge(beside(pairs, after, rest + 0.2 * (np.arange(len(rest)) % 3 == 0)), time_s, yaw, 0.0)
    assert "in 33% of " in note and "while the wheels do not turn, images do, by" in note


@pytest.mark.parametrize(("wheel", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_wheel_that_counts_backward_is_named(wheel: str, sign: float):
    """What is a turn is a drive by the wheels, and the other way round."""
    pairs, time_s, yaw = see(0.0)
    still = pairs._replace(turned=0.001 * np.cos(pairs.first_s))
    with pytest.raises(InputError, match=rf"one of them counts backward, by the images the {wheel} one"):
        judge_pairs(beside(still, pairs, pairs.turned), time_s, 3.0 * time_s, sign * yaw, 0.0, "/camera")
