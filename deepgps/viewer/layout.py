"""How the viewer shows a run: its tabs, and what each shows."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps import figures
from deepgps.report import method_title
from deepgps.viewer.timeline import DRIVE_TIME, PROGRESS, PROGRESS_END
from sim.records import FreeSpace

CAMERAS = {
    "fisheye": "Fisheye, forward is up",
    "polar": "Polar image, zenith at the top",
    "horizontal": "Horizontal camera",
}


def make_blueprint(
    space: FreeSpace,
    methods: Sequence[str],
    trained: Sequence[str],
    cameras: Sequence[str] = ("fisheye", "polar"),
    tab: int = 0,
) -> rrb.Blueprint:
    """How the viewer shows a run, with what its cameras saw: what matters first, without a click."""
    return rrb.Blueprint(
        rrb.Tabs(
            _overview(space, methods[0]),
            _error_fields(space, methods),
            _drive(space, cameras),
            *([_training(space, trained)] if trained else []),
            _report(),
            active_tab=tab,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=PROGRESS, fps=PROGRESS_END / 100, play_state="paused"),
        auto_views=False,
    )


def _overview(space: FreeSpace, method: str) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.Spatial3DView(
            name=f"Error field of {method_title(method)}",
            origin="world",
            contents=["world/room", "world/floor_plan", "world/scale/**", f"world/error_field/{method}/**"],
            eye_controls=_eye(space, tilt=0.45, reach=1.08),
            line_grid=False,
        ),
        rrb.TextDocumentView(name="Figures", origin="report/figures"),
        column_shares=[5, 2],
        name="Overview",
    )


def _error_fields(space: FreeSpace, methods: Sequence[str]) -> rrb.Grid:
    return rrb.Grid(
        *(
            rrb.Spatial3DView(
                name=method_title(method),
                origin="world",
                contents=["world/floor_plan", "world/scale/**", f"world/error_field/{method}/**"],
                eye_controls=_eye(space),
                line_grid=False,
            )
            for method in methods
        ),
        grid_columns=2,
        name="Error field",
    )


def _drive(space: FreeSpace, cameras: Sequence[str]) -> rrb.Horizontal:
    relative, infinite = rr.TimeRangeBoundary.cursor_relative, rr.TimeRangeBoundary.infinite
    recent = [
        rr.VisibleTimeRange(DRIVE_TIME, start=relative(seconds=-60), end=relative(seconds=0)),
        rr.VisibleTimeRange(PROGRESS, start=relative(seq=-PROGRESS_END // 50), end=relative(seq=0)),
    ]
    so_far = [
        rr.VisibleTimeRange(DRIVE_TIME, start=infinite(), end=relative(seconds=0)),
        rr.VisibleTimeRange(PROGRESS, start=infinite(), end=relative(seq=0)),
    ]
    room = rrb.Spatial3DView(
        name="Robot and path so far",
        origin="world",
        contents=["world/room", "world/drive/**"],
        eye_controls=_eye(space, tilt=0.45, reach=1.3),
        line_grid=False,
        overrides={"world/drive/path": rrb.VisibleTimeRanges(so_far)},
    )
    pictures = rrb.Horizontal(
        *(rrb.Spatial2DView(name=CAMERAS[camera], origin=f"drive/{camera}") for camera in cameras),
        column_shares=[1 if camera == "fisheye" else 2 for camera in cameras],
    )
    return rrb.Horizontal(
        room,
        rrb.Vertical(
            *([pictures] if cameras else []),
            rrb.TimeSeriesView(name="Distance on this segment [m]", origin="drive/distance", time_ranges=recent),
            rrb.TimeSeriesView(
                name="Encoder minus truth, all the way [mm]", origin="drive/difference", axis_x=whole_axis()
            ),
            rrb.TimeSeriesView(name="Ticks", origin="drive/ticks", time_ranges=recent),
            row_shares=[3, 2, 2, 2] if cameras else [1, 1, 1],
        ),
        column_shares=[5, 4],
        name="Drive",
    )


def _training(space: FreeSpace, trained: Sequence[str]) -> rrb.Vertical:
    return rrb.Vertical(
        rrb.Horizontal(
            *(
                rrb.Spatial3DView(
                    name=f"{method_title(name)}: where it puts the training images",
                    origin="world",
                    contents=["world/outline", f"world/training/{name}"],
                    eye_controls=_eye(space),
                    line_grid=False,
                )
                for name in trained
            )
        ),
        rrb.Horizontal(
            *(
                rrb.TimeSeriesView(
                    name=f"{method_title(name)}: loss, log10", origin=f"training/{name}", axis_x=whole_axis()
                )
                for name in trained
            )
        ),
        row_shares=[3, 2],
        name="Training",
    )


def _report() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(name="Report", origin="report/text"),
        rrb.Tabs(
            rrb.Spatial2DView(name="Error fields", origin="report/error_fields"),
            rrb.Spatial2DView(name="Error distribution", origin="report/error_cdf"),
            rrb.Spatial2DView(name="Training", origin="report/training"),
        ),
        column_shares=[2, 3],
        name="Report",
    )


def whole_axis() -> rrb.TimeAxis:
    """A time axis that shows a series from its first to its last value."""
    infinite = rr.TimeRangeBoundary.infinite
    return rrb.TimeAxis(view_range=rr.TimeRange(start=infinite(), end=infinite()))


def _eye(space: FreeSpace, tilt: float = 0.0, reach: float = 1.0) -> rrb.EyeControls3D:
    """An eye above the room, tilted towards the south by ``tilt`` [rad], ``reach`` times as far as for a plan."""
    low, high = figures.limits(space)
    middle = np.array([*(low + high) / 2, 0.0]) - [0, 0.25, 0]  # the scale lies before the room
    distance = reach * (1.2 * max(high[1] - low[1], 0.62 * (high[0] - low[0])) + 0.8)
    away = distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    # an eye exactly above has no up direction of its own: north is up
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=middle + away, look_target=middle, eye_up=(0.0, 1.0, 0.0)
    )
