"""What every group of settings refuses, whatever the types of its fields."""

from typing import Any

import pytest
from pydantic import Field, ValidationError

from sim.settings import Group, SimSettings


class Mixed(Group):
    """Fields of all types that settings have."""

    number: float | None = None
    numbers: tuple[int, ...] = ()
    table: dict[str, float] = Field(default_factory=dict)
    switch: bool | float = False
    switches: tuple[bool, ...] = ()
    anything: dict[str, tuple[Any, ...]] = Field(default_factory=dict)
    inner: tuple["Mixed", ...] = ()


@pytest.mark.parametrize("wrong", [{"number": True}, {"numbers": [1, False]}, {"table": {"a": True}}])
def test_true_and_false_are_no_numbers(wrong: dict):
    for values in (wrong, {"inner": [wrong]}):
        with pytest.raises(ValidationError, match="Input should be numeric, not true or false"):
            Mixed.model_validate(values)


def test_true_and_false_stay_where_they_are_meant():
    mixed = Mixed.model_validate({"switch": True, "switches": [False], "anything": {"a": [True, 1]}})
    assert (mixed.switch is True, mixed.switches, mixed.anything) == (True, (False,), {"a": (True, 1)})


@pytest.mark.parametrize(
    ("drive", "grid", "message"),
    [
        ({"until": {"unseen": 0.1}}, {}, "until.unseen needs headings map or frontier, which draw a map, not explore"),
        ({"until": {"radius_m": 0.1}, "headings": "map"}, {}, "until.radius_m 0.1 is asked for after until.unseen"),
        ({"until": {"unseen": 0.1}, "headings": "map"}, {"held_out": 9}, "grid.held_out 9 follows it"),
    ],
)
def test_a_drive_is_done_early_only_by_a_map_and_before_nothing(drive: dict, grid: dict, message: str):
    with pytest.raises(ValidationError, match=message):
        SimSettings.model_validate({"drive": drive, "grid": grid})


def test_whole_numbers_stand_for_fractions():
    assert Mixed(number=1, table={"a": 2}) == Mixed(number=1.0, table={"a": 2.0})
