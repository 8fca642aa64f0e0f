"""The viewer's layout for a study: its tabs and their contents."""

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from deepgps.methods.catalog import title_of
from deepgps.viewer.run.layout import whole_axis

Frame = tuple[np.ndarray, np.ndarray]  # south-west and north-east corners (2,) [m] of the rectangle for every room
STEPS_PER_SECOND = 1.5
CURVES = {"rms": "RMS", "median": "Median"}


def make_blueprint(slider: str, methods: Sequence[str], figures: Sequence[str], frame: Frame) -> rrb.Blueprint:
    """The viewer's layout for a study, which opens with the error fields of all methods side by side.

    Args:
        slider: Name of the timeline to open with.
        methods: Names of the methods.
        figures: Names of the study's figures.
        frame: Rectangle in which every room is drawn.
    """
    return rrb.Blueprint(
        rrb.Tabs(
            _error_fields(methods, frame),
            _curves(),
            *([_figures(figures)] if figures else []),
            rrb.TextDocumentView(name="Report", origin="report/table"),
            active_tab=0,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=slider, fps=STEPS_PER_SECOND, play_state="paused"),
        auto_views=False,
    )


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
        )
        for method in methods
    )
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Grid(*fields, grid_columns=1 if len(methods) == 1 else 2),
            rrb.Horizontal(*(_curve(name, methods) for name in CURVES)),
            row_shares=[4, 1],
        ),
        rrb.Vertical(
            rrb.TextDocumentView(name="Here", origin="report/here"),
            rrb.TextDocumentView(name="Sliders", origin="report/sliders"),
        ),
        column_shares=[5, 2],
        name="Error fields",
    )


def _curve(name: str, methods: Sequence[str]) -> rrb.TimeSeriesView:
    """A small plot without a legend, since its colours are those of the text above each field."""
    return rrb.TimeSeriesView(
        name=f"{CURVES[name]} along the slider [cm]",
        origin=f"curve/{name}",
        contents=[f"curve/{name}/{method}" for method in methods],
        axis_x=whole_axis(),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _curves() -> rrb.Horizontal:
    views = (
        rrb.TimeSeriesView(
            name=f"{title} [cm], mean, best and worst of the seeds", origin=f"curve/{name}", axis_x=whole_axis()
        )
        for name, title in CURVES.items()
    )
    return rrb.Horizontal(
        rrb.Vertical(*views),
        rrb.TextDocumentView(name="Here", origin="report/here"),
        column_shares=[5, 2],
        name="Curves",
    )


def _figures(figures: Sequence[str]) -> rrb.Tabs:
    return rrb.Tabs(
        *(rrb.Spatial2DView(name=name.replace("_", " "), origin=f"report/figures/{name}") for name in figures),
        name="Figures",
    )


def _eye(frame: Frame, wide: bool) -> rrb.EyeControls3D:
    """Place the eye above the frame so that a wide or high panel shows the frame, its heading and its scale."""
    width, depth = frame[1] - frame[0]
    seen = max(depth + 2.2, 1.1 * width / (1.5 if wide else 0.83))
    # the viewer's field of view is 55 degrees; an eye exactly above has no up direction of its own, so north is up
    distance = seen / (2 * np.tan(np.radians(55 / 2)))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=(0.0, 0.0, distance), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 1.0, 0.0)
    )
