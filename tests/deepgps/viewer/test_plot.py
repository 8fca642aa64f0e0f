"""Axes of plots: round ticks that hold all values, and positions in proportion."""

from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb
from hypothesis import given
from hypothesis import strategies as st

from deepgps.viewer.plot import Curve, log_plot, make_axis, plot_view
from deepgps.viewer.read import read_entity
from deepgps.viewer.sliders import Slider, Step
from deepgps.viewer.stream import save_recording

VALUES = st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=20)


@given(VALUES, st.booleans())
def test_an_axis_holds_its_values_in_order_between_its_ticks(values: list[float], log: bool) -> None:
    axis = make_axis("", values, log=log)
    share = axis.share(values)
    assert ((share >= 0) & (share <= 1)).all()
    assert (np.diff(share[np.argsort(values)]) >= 0).all()
    assert axis.low <= min(values) * (1 + 1e-9) and axis.high >= max(values) * (1 - 1e-9)
    assert 2 <= len(axis.ticks) <= 20
    assert all(axis.low <= tick <= axis.high for tick in axis.ticks)


@given(st.floats(1, 9))
def test_positions_are_in_proportion(ratio: float) -> None:
    axis = make_axis("", [0.0, 10.0], zero=True)
    assert axis.share([ratio])[0] == pytest.approx(ratio * axis.share([1.0])[0])
    log = make_axis("", [1.0, 100.0], log=True)
    assert log.share([ratio**2])[0] == pytest.approx(2 * log.share([ratio])[0], abs=1e-9)


@pytest.mark.parametrize("count", [1, 8, 20])
def test_no_row_of_the_legend_is_over_another_or_over_the_title_of_the_abscissa(count: int, tmp_path: Path) -> None:
    axis, path = make_axis("x", [0.0, 1.0]), tmp_path / "plot.rrd"
    curves = [Curve(f"{number}", f"{number}", (0, 0, 0), [0, 1], [0, 1]) for number in range(count)]
    layout = rrb.Blueprint(plot_view("plot", "plot"))
    save_recording(path, f"{count:032x}", "plot", layout, lambda stream: log_plot(stream, "plot", axis, axis, curves))
    rows, titles = (
        [place[1] for place in read_entity(path, f"plot/{name}")["Points2D:positions"].to_pylist()[0]]
        for name in ("legend", "axes/titles")
    )
    assert len(rows) == count
    assert (np.diff([*rows, titles[0]]) > 0.03).all()


@pytest.mark.parametrize(
    ("values", "timeline", "places"),
    [
        ([0.0, 0.02, 0.1], "noise [1/100]", [0, 2, 10]),
        ([16.0, 64.0, 4096.0], "noise", [16, 64, 4096]),
        ([-0.5, 0.0, 0.5], "noise [1/10]", [-5, 0, 5]),
        ([None, None], "noise", [1, 2]),
        ([1 / 3, 2 / 3], "noise", [1, 2]),
    ],
)
def test_a_slider_has_its_values_on_its_timeline(values: list[float | None], timeline: str, places: list[int]) -> None:
    slider = Slider("noise", [Step("", "", [], [], number) for number in values], "")
    assert (slider.timeline, slider.places) == (timeline, places)
