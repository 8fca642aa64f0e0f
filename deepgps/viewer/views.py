"""Parts that several layouts share: views, their eyes, and the times that they show."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.viewer.timeline import DRIVE_TIME, PROGRESS, PROGRESS_END_S
from sim.occupancy import FreeSpace, limits

STILL = rrb.EntityBehavior(interactive=False)
HIDDEN = rrb.EntityBehavior(visible=False)
BACKDROP = ("room", "floor_plan", "outline", "scale")
Overrides = dict[Any, Any]  # by entity


def arrange(tabs: Sequence[rrb.Container | rrb.View], time: rrb.TimePanel, active: int = 0) -> rrb.Blueprint:
    """A layout of tabs between panels that are closed, since the tooltip says what the selection panel would."""
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=active),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
    )


def hold_still(root: str = "world") -> Overrides:
    """Overrides for a view, so that only what can tell something catches the pointer."""
    return {f"{root}/{name}": STILL for name in BACKDROP}


def field_view(
    name: str,
    method: str,
    eye: rrb.EyeControls3D,
    around: Sequence[str],
    hidden: Sequence[str] = (),
    root: str = "world",
) -> rrb.Spatial3DView:
    """A view of a method's error field with other entities below ``root`` around it, some of them hidden at first."""
    return rrb.Spatial3DView(
        name=name,
        origin=root,
        contents=[*(f"{root}/{one}" for one in around), f"{root}/error_field/{method}/**"],
        eye_controls=eye,
        line_grid=False,
        overrides={**hold_still(root), **dict.fromkeys(hidden, HIDDEN)},
    )


def series_view(name: str, path: str, lately_s: float | None = None, drive_s: float = 0.0) -> rrb.TimeSeriesView:
    """A plot along the slider, of everything or of the last seconds, whose name says what a legend would."""
    return rrb.TimeSeriesView(
        name=name,
        origin=path,
        plot_legend=rrb.PlotLegend(visible=False),
        axis_x=whole_axis() if lately_s is None else None,
        time_ranges=None if lately_s is None else lately(lately_s, drive_s),
    )


def whole_axis() -> rrb.TimeAxis:
    """Show a plot from its first to its last value."""
    infinite = rr.TimeRangeBoundary.infinite
    return rrb.TimeAxis(view_range=rr.TimeRange(start=infinite(), end=infinite()))


def until_now() -> list[rrb.VisibleTimeRange]:
    """Show what was logged from the start to the slider."""
    infinite = rr.TimeRangeBoundary.infinite
    return _since(infinite(), infinite())


def lately(seconds: float, drive_s: float) -> list[rrb.VisibleTimeRange]:
    """Show the last seconds [s] of the drive, also on the timeline ``progress``, on which the drive is rescaled."""
    relative, share = rr.TimeRangeBoundary.cursor_relative, seconds / max(drive_s, seconds)
    return _since(relative(seconds=-seconds), relative(seconds=-PROGRESS_END_S * share))


def _since(drive_time: rr.TimeRangeBoundary, progress: rr.TimeRangeBoundary) -> list[rrb.VisibleTimeRange]:
    now = rr.TimeRangeBoundary.cursor_relative(seconds=0)
    return [
        rrb.VisibleTimeRange(DRIVE_TIME, start=drive_time, end=now),
        rrb.VisibleTimeRange(PROGRESS, start=progress, end=now),
    ]


def aim_eye(space: FreeSpace, tilt: float = 0.0, reach: float = 1.0, before: float = 0.25) -> rrb.EyeControls3D:
    """Place the eye above the room, with space for the scale in front of it.

    Args:
        space: The room's floor.
        tilt: How far the eye is tilted to the south [rad].
        reach: Distance of the eye, as a multiple of the distance at which the plan is visible.
        before: How far south of the room's middle the eye looks [m].
    """
    return aim_eye_at(*limits(space), tilt, reach, before)


def aim_eye_at(
    low: np.ndarray, high: np.ndarray, tilt: float = 0.0, reach: float = 1.0, before: float = 0.0
) -> rrb.EyeControls3D:
    """Place the eye above a rectangle of the floor from ``low`` to ``high`` (2,) [m], as ``aim_eye`` does."""
    middle = np.array([*(low + high) / 2, 0.0]) - [0, before, 0]
    distance = reach * (1.2 * max(high[1] - low[1], 0.62 * (high[0] - low[0])) + (0.8 if before else 0.1))
    away = distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    # an eye exactly above the room has no up direction of its own, so north is up
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=middle + away, look_target=middle, eye_up=(0.0, 1.0, 0.0)
    )
