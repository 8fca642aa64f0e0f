"""The viewer's layout for a study: its tabs and their contents."""

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.viewer.plot import plot_view
from deepgps.viewer.study.sliders import Slider
from deepgps.viewer.views import STILL, arrange

Frame = tuple[np.ndarray, np.ndarray]  # south-west and north-east corners (2,) [m] of the rectangle for every room
STEPS_PER_SECOND = 1.5
CURVES = {"rms": "RMS", "median": "Median"}


def make_blueprint(slider: Slider, methods: Sequence[str], figures: Sequence[str], frame: Frame) -> rrb.Blueprint:
    """The viewer's layout for a study, which opens with the error fields of all methods side by side.

    Args:
        slider: The slider to open with.
        methods: Names of the methods.
        figures: Names of the study's figures.
        frame: Rectangle in which every room is drawn.
    """
    tabs = [_error_fields(methods, frame), _curves(), *([_figures(figures)] if figures else []), _report()]
    apart = float(np.ptp(slider.places)) / max(len(slider.steps) - 1, 1)
    fps = STEPS_PER_SECOND * max(apart, 1.0)
    return arrange(tabs, rrb.TimePanel(state="collapsed", timeline=slider.timeline, fps=fps, play_state="paused"))


def _error_fields(methods: Sequence[str], frame: Frame) -> rrb.Horizontal:
    fields = (
        rrb.Spatial3DView(
            name=title_of(method),
            origin="/",
            contents=[
                *("world/floor_plan", "world/outline", "world/metre/**", "scale/**"),
                *(f"world/error_field/{method}/**", f"heading/{method}"),
            ],
            eye_controls=_eye(frame, wide=len(methods) != 2),
            line_grid=False,
            overrides=dict.fromkeys(["world/floor_plan", "world/outline", "world/metre", "scale"], STILL),
        )
        for method in methods
    )
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Grid(*fields, grid_columns=1 if len(methods) == 1 else 2),
            rrb.Horizontal(*_plots()),
            row_shares=[5, 2],
        ),
        rrb.Vertical(
            rrb.TextDocumentView(name="Here", origin="report/here"),
            rrb.TextDocumentView(name="Sliders", origin="report/sliders"),
        ),
        column_shares=[5, 2],
        name="Error fields",
    )


def _plots() -> list[rrb.Spatial2DView]:
    return [plot_view(f"{title} along the slider [cm]", f"curve/{name}") for name, title in CURVES.items()]


def _curves() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.Vertical(*_plots()),
        rrb.TextDocumentView(name="Here", origin="report/here"),
        column_shares=[5, 2],
        name="Curves",
    )


def _report() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(name="Table", origin="report/table"),
        rrb.TextDocumentView(name="Here", origin="report/here"),
        column_shares=[5, 2],
        name="Report",
    )


def _figures(figures: Sequence[str]) -> rrb.Horizontal:
    pictures = (rrb.Spatial2DView(name=name.replace("_", " "), origin=f"report/figures/{name}") for name in figures)
    here = rrb.TextDocumentView(name="Here", origin="report/here")
    return rrb.Horizontal(rrb.Tabs(*pictures), here, column_shares=[5, 2], name="Figures")


def _eye(frame: Frame, wide: bool) -> rrb.EyeControls3D:
    """Place the eye above the frame so that a wide or high panel shows the frame, its heading and its scale."""
    width, depth = frame[1] - frame[0]
    seen = max(depth + 2.2, 1.1 * width / (1.5 if wide else 0.83))
    # the viewer's field of view is 55 degrees; an eye exactly above has no up direction of its own, so north is up
    distance = seen / (2 * np.tan(np.radians(55 / 2)))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=(0.0, 0.0, distance), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 1.0, 0.0)
    )
