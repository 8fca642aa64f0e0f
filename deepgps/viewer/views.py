"""Parts that several layouts share: views and their eyes."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.viewer.timeline import lately
from sim.geometry import FreeSpace, limits

STILL = rrb.EntityBehavior(interactive=False)
HIDDEN = rrb.EntityBehavior(visible=False)
BACKDROP = ("room", "floor_plan", "outline", "scale")
"""Entities that cannot tell anything and so do not catch the pointer."""
EYE = rrb.EyeControls3D(
    kind=rrb.Eye3DKind.Orbital, position=(0.0, -3.0, 6.4), look_target=(0.0, -0.3, 0.0), eye_up=(0.0, 1.0, 0.0)
)
"""View until the room is known: it shows all of a room of usual size."""


def arrange(tabs: Sequence[rrb.Container | rrb.View], time: rrb.TimePanel, active: int = 0) -> rrb.Blueprint:
    """A layout of tabs between panels that are closed, since the tooltip says what the selection panel would."""
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=active),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
    )


def room_view(
    name: str,
    contents: Iterable[str],
    eye: rrb.EyeControls3D,
    root: str = "world",
    overrides: Mapping[Any, Any] | None = None,
    line_grid: bool = False,
) -> rrb.Spatial3DView:
    """A view of entities below ``root``, of which only what can tell something catches the pointer."""
    return rrb.Spatial3DView(
        name=name,
        origin=root,
        contents=[f"{root}/{one}" for one in contents],
        eye_controls=eye,
        line_grid=line_grid,
        overrides={f"{root}/{name}": STILL for name in BACKDROP} | dict(overrides or {}),
    )


def field_view(
    name: str,
    method: str,
    eye: rrb.EyeControls3D,
    around: Sequence[str],
    hidden: Iterable[str] = (),
    root: str = "world",
) -> rrb.Spatial3DView:
    """A view of a method's error field with other entities below ``root`` around it, some of them hidden at first."""
    return room_view(name, [*around, f"error_field/{method}/**"], eye, root, dict.fromkeys(hidden, HIDDEN))


def text_view(name: str, origin: str) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(name=name, origin=origin)


def series_view(
    name: str, path: str, lately_s: float | None = None, drive_s: float = 0.0, since: rrb.TimeAxis | None = None
) -> rrb.TimeSeriesView:
    """A plot along the slider, of everything or of the last seconds, whose name says what a legend would."""
    infinite = rr.TimeRangeBoundary.infinite
    whole = since or rrb.TimeAxis(view_range=rr.TimeRange(start=infinite(), end=infinite()))
    return rrb.TimeSeriesView(
        name=name,
        origin=path,
        plot_legend=rrb.PlotLegend(visible=False),
        axis_x=whole if lately_s is None else None,
        time_ranges=None if lately_s is None else lately(lately_s, drive_s),
    )


def aim_eye(space: FreeSpace | None, tilt: float = 0.0, reach: float = 1.0, before: float = 0.25) -> rrb.EyeControls3D:
    """Place the eye above the room, with space for the scale in front of it.

    Args:
        space: The room's floor; None: it is not known.
        tilt: How far the eye is tilted to the south [rad].
        reach: Distance of the eye, as a multiple of the distance at which the plan is visible.
        before: How far south of the room's middle the eye looks [m].
    """
    return EYE if space is None else aim_eye_at(*limits(space), tilt, reach, before)


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
