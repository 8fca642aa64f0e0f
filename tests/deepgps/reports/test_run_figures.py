"""Figures: the worst heading decides, one colour scale for all, equal runs give equal files."""

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.artist import Artist
from matplotlib.colors import to_hex

from deepgps.evaluation.error_field import ErrorField, find_worst, read_all_headings, read_fields
from deepgps.reports import run_figures
from deepgps.reports.plots import REFUSED_COLOUR, SCALE_M, colours_of, smooth, to_png
from deepgps.reports.run_figures import draw_comparison, draw_figures
from sim.errors import InputError
from sim.geometry import limits
from tests.helpers.synthetic_run import make_free_space, write_synthetic_run

HEAD = {"scenario": "room", "seed": 0, "samples": 60}
POSITIONS = arrays(float, (5, 3, 2), elements=st.floats(-10, 10))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic_run(tmp_path_factory.mktemp("run"), samples=60, spacing_m=0.4)


@given(POSITIONS)
def test_the_worst_heading_decides(predicted: np.ndarray) -> None:
    truth = np.arange(10.0).reshape(5, 2)
    field = find_worst(ErrorField(truth, np.zeros(3), predicted))
    for cell in range(5):
        errors = [np.hypot(*(predicted[cell, heading] - truth[cell])) for heading in range(3)]
        assert field.error[cell] == pytest.approx(max(errors))
        assert any(np.array_equal(field.predicted[cell], predicted[cell, heading]) for heading in range(3))
    np.testing.assert_allclose(np.linalg.norm(field.predicted - truth, axis=1), field.error)


def test_colours_depend_on_the_error_alone_and_end_with_the_scale() -> None:
    error = np.array([0.0, SCALE_M[0], 0.05, SCALE_M[1], 50.0])
    colours = colours_of(error)
    np.testing.assert_array_equal(colours[0], colours[1])
    np.testing.assert_array_equal(colours[3], colours[4])
    np.testing.assert_array_equal(colours_of(error[2:3])[0], colours[2])  # whatever else is drawn
    assert len(np.unique(colours, axis=0)) == 3


@given(arrays(float, st.integers(1, 300), elements=st.floats(0, 1)))
def test_smoothing_stays_within_the_values(values: np.ndarray) -> None:
    smoothed = smooth(values)
    assert smoothed.shape == values.shape
    assert values.min() <= smoothed.min()
    assert smoothed.max() <= values.max()


def test_limits_enclose_the_reachable_area() -> None:
    space = make_free_space()
    low, high = limits(space, margin_m=0.0)
    row, column = np.nonzero(space.reachable)
    points = space.origin + np.stack([column, row], axis=1) * space.cell_m
    assert (points >= low - 1e-9).all()
    assert (points <= high + 1e-9).all()
    np.testing.assert_allclose(limits(space, margin_m=0.5)[0], low - 0.5)


def test_every_figure_is_written_as_png(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_figures, "to_png", lambda _: b"\x89PNG")  # one is drawn below
    paths = draw_figures(run)
    names = {"error_fields", "error_cdf", "drive"}
    assert {path.stem for path in paths} == names
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert all(path.parent == run / "figures" for path in paths)


def test_a_narrow_drive_along_y_has_a_figure_that_can_be_drawn(run: Path) -> None:
    reachable = np.zeros((2400, 3), bool)
    reachable[:, 1] = True
    space = replace(make_free_space(), free=reachable, reachable=reachable, origin=np.zeros(2), cell_m=0.1)
    assert np.ptp(limits(space), axis=0)[1] > 100 * np.ptp(limits(space), axis=0)[0]
    figure = draw_comparison(space, {"deepgps": read_all_headings(run)["deepgps"]}, HEAD)
    assert figure.get_figheight() < 40.0
    field = {"knn": read_all_headings(run)["knn"]}
    first, second = (to_png(draw_comparison(make_free_space(), field, HEAD)) for _ in "ab")
    assert first == second and b"Matplotlib" not in first, "equal figures give equal bytes"


def list_arrows(quiver: Artist) -> np.ndarray:
    """Origins and vectors (n, 4) of drawn arrows."""
    return np.stack([np.asarray(getattr(quiver, name)) for name in ("X", "Y", "U", "V")], axis=1)


def test_the_arrows_are_drawn_to_scale(run: Path) -> None:
    space, field = make_free_space(), read_all_headings(run)["knn"]
    axes = draw_comparison(space, {"knn": field}, HEAD).axes[0]
    refused, arrows = (part for part in axes.collections if hasattr(part, "U"))
    assert list_arrows(refused).shape == (0, 4)
    field, drawn = find_worst(field), list_arrows(arrows)
    expected = np.concatenate([field.truth, field.predicted - field.truth], axis=1)
    np.testing.assert_allclose(drawn[np.lexsort(drawn.T)], expected[np.lexsort(expected.T)])
    assert getattr(arrows, "scale", None) == 1
    assert axes.get_aspect() == 1


def test_refused_images_are_grey_and_the_others_have_colours(run: Path) -> None:
    field = read_all_headings(run)["knn"]
    accepted = np.random.default_rng(0).random(field.error.shape) < 0.5
    figure = draw_comparison(make_free_space(), {"knn": replace(field, accepted=accepted)}, HEAD)
    refused, arrows = (part for part in figure.axes[0].collections if hasattr(part, "U"))
    assert len(list_arrows(arrows)) == accepted.any(axis=1).sum()
    assert len(list_arrows(refused)) == (~accepted).any(axis=1).sum()
    assert {to_hex(colour) for colour in refused.get_facecolors()} == {REFUSED_COLOUR}
    assert "grey: images that the method refuses" in figure.legends[0].texts[0].get_text()
    assert f"{100 * accepted.mean():.1f} % accepted" in figure.axes[0].get_title("right")
    assert not draw_comparison(make_free_space(), {"knn": field}, HEAD).legends


def test_a_foreign_backend_changes_no_figure(run: Path) -> None:
    field, space, before = read_all_headings(run)["knn"], make_free_space(), matplotlib.get_backend()
    drawn = to_png(draw_comparison(space, {"knn": field}, HEAD))
    matplotlib.use("svg")
    try:
        assert to_png(draw_comparison(space, {"knn": field}, HEAD)) == drawn
    finally:
        matplotlib.use(before)


def test_a_broken_error_field_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "error_field.npz"
    for write, message in (
        (lambda: None, r"no whole run: error_field.npz is missing"),
        (lambda: path.write_bytes(b"PK\x03\x04 half"), r"error_field\.npz is damaged"),
        (lambda: np.savez(path, deepgps=np.zeros((1, 1, 2))), "truth"),
    ):
        write()
        with pytest.raises(InputError, match=message):
            read_fields(tmp_path)
