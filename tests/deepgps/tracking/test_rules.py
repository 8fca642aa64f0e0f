"""The table of rules: order, windows, and that each cause can be named."""

from dataclasses import fields

import numpy as np
import pytest

from deepgps.tracking.rules import (
    AROUND,
    FAULTY,
    RULES,
    TITLES,
    WINDOW,
    Evidence,
    find_long,
    label,
    median_around,
    share_around,
)


def make_evidence(**held: bool) -> Evidence:
    """Evidence of one image, of which only this holds."""
    return Evidence(**{one.name: np.array([held.get(one.name, False)]) for one in fields(Evidence)})


@pytest.mark.parametrize(
    ("held", "name"),
    [
        ({"accepted": True}, ""),
        ({}, "new_place"),
        ({"long_new": True}, "other_room"),
        ({"known_place": True, "unusual": True}, "furniture"),
        ({"known_place": True, "often_refused": True}, "furniture"),
        ({"known_place": True}, "new_place"),
        ({"known_place": True, "unusual": True, "beyond": True}, "new_place"),
        ({"known_place": True, "beyond": True, "changed": True}, "furniture"),
        ({"known_place": True, "leaning": True}, "camera"),
        ({"known_place": True, "relit": True, "accepted": True}, "light"),
        ({"mostly_relit": True}, "light"),
        ({"mostly_relit": True, "accepted": True}, ""),
        ({"frozen": True, "accepted": True}, "frozen"),
        ({"covered": True, "known_place": True}, "covered"),
        ({"white": True, "covered": True}, "white"),
        ({"black": True, "covered": True}, "black"),
    ],
)
def test_the_first_rule_that_holds_names_the_cause(held: dict[str, bool], name: str):
    assert label(make_evidence(**held)).tolist() == [name]


def test_a_refused_image_always_has_a_cause_and_names_are_unique():
    rng = np.random.default_rng(0)
    seen = Evidence(**{one.name: rng.random(1000) < 0.5 for one in fields(Evidence)})
    assert "" not in set(label(seen)[~seen.accepted])
    assert len({cause.name for cause in RULES}) == len(RULES)
    assert set(FAULTY) < set(TITLES)


def test_a_long_stretch_is_of_another_room_and_a_short_one_is_not():
    new = np.zeros(3 * WINDOW, bool)
    new[WINDOW : 2 * WINDOW] = True
    new[WINDOW + 20] = False
    assert find_long(new)[WINDOW : 2 * WINDOW].all()
    assert not find_long(new)[: WINDOW // 2].any()
    new[WINDOW + 40 :] = False
    assert not find_long(new).any()
    assert find_long(np.ones(5, bool)).all()
    assert find_long(np.zeros(0, bool)).shape == (0,)


def test_shares_and_medians_are_those_of_the_images_around():
    rng = np.random.default_rng(1)
    found, values = rng.random(300) < 0.3, rng.random(300)
    share, median = share_around(found), median_around(values, found)
    for row in (0, 10, 150, 299):
        some = slice(max(0, row - AROUND), row + AROUND + 1)
        assert share[row] == pytest.approx(found[some].mean())
        assert median[row] == pytest.approx(np.median(values[some][found[some]]))
    assert np.isnan(median_around(values, np.zeros(300, bool))).all()
