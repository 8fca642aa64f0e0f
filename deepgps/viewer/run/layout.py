"""The viewer's layout for a run: its tabs and their contents."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.methods.catalog import title_of
from deepgps.viewer.distribution import distribution_view
from deepgps.viewer.run.coverage import COVERAGE, DENSITY
from deepgps.viewer.run.pictures import LARGE
from deepgps.viewer.run.places import PICTURES
from deepgps.viewer.timeline import DRIVE_TIME, PROGRESS, PROGRESS_END_S
from sim.occupancy import FreeSpace, limits

RECENT_S, TRAIL_S = 60.0, 120.0
STILL = rrb.EntityBehavior(interactive=False)
HIDDEN = rrb.EntityBehavior(visible=False)
BACKDROP = ("room", "floor_plan", "outline", "scale")
Overrides = dict[Any, Any]  # by entity
Headings = Mapping[str, Sequence[str]]
"""Entities of a method's error field at each heading, by method."""


def make_blueprint(
    space: FreeSpace, headings: Headings, trained: Sequence[str], pictures: Mapping[str, str], drive_s: float
) -> rrb.Blueprint:
    """The viewer's layout for a run, which opens with what matters most.

    Args:
        space: The room's floor.
        headings: Measured methods, and the entities of each heading.
        trained: Methods with a training history.
        pictures: Titles of the sensors' pictures, by name.
        drive_s: Duration of the drive [s].
    """
    return arrange(
        [
            _error_fields(space, headings),
            _worst_places(space, list(headings), "polar" in pictures),
            _drive(space, pictures, drive_s),
            *([_training(space, trained)] if trained else []),
            _encoders(space, drive_s),
            _report(),
        ],
        # opens at the end of drive and training
        rrb.TimePanel(state="collapsed", timeline=PROGRESS, play_state="following"),
    )


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


def _error_fields(space: FreeSpace, headings: Headings) -> rrb.Horizontal | rrb.Vertical:
    """The first method's error field in the furnished room, all figures, and the other methods' fields as plans."""
    first, *others = headings
    layers = [path.removeprefix("world/") for path in (COVERAGE, DENSITY)]
    hidden = {method: [*paths, COVERAGE, DENSITY] for method, paths in headings.items()}
    around = ["floor_plan", "scale/**", "place/test", *layers]
    oblique, above = aim_eye(space, tilt=0.45, reach=1.08), aim_eye(space, reach=1.0)
    room = rrb.Tabs(
        field_view(f"Error field of {title_of(first)}", first, oblique, ["room", *around], hidden[first]),
        field_view("From above", first, above, around, hidden[first]),
        active_tab=0,
    )
    plans = [
        field_view(
            title_of(method), method, aim_eye(space, reach=0.85, before=0.0), ["floor_plan", *layers], hidden[method]
        )
        for method in others
    ]
    figures_of_all = rrb.TextDocumentView(name="Figures", origin="report/figures")
    if len(plans) < 2:
        beside = rrb.Vertical(figures_of_all, *plans)
        return rrb.Horizontal(room, beside, column_shares=[5, 2], name="Error field")
    above_all = rrb.Horizontal(room, figures_of_all, column_shares=[5, 2])
    return rrb.Vertical(above_all, rrb.Horizontal(*plans), row_shares=[5, 3], name="Error field")


def _worst_places(space: FreeSpace, methods: Sequence[str], pictures: bool) -> rrb.Horizontal:
    """One of the worst places on the floor plan, its numbers, and its test image beside training images."""
    floor = rrb.Spatial3DView(
        name="The place, and where the training images were taken",
        origin="world",
        contents=["world/floor_plan", "world/outline", "world/place/**"],
        eye_controls=aim_eye(space, before=0.0),
        line_grid=False,
        overrides=hold_still(),
    )
    text = rrb.TextDocumentView(name="Place", origin="place/text")
    if not pictures:
        return rrb.Horizontal(floor, text, column_shares=[5, 3], name="Worst places")
    titles = ["Test image", "Alike 1, yellow", "Alike 2, yellow", "Closest, green"]
    rows = [
        rrb.Horizontal(
            *(
                rrb.Spatial2DView(name=title, origin=f"place/{name}/{kind}")
                for title, name in zip(titles, PICTURES, strict=True)
            )
        )
        for kind in ("round", "polar")
    ]
    return rrb.Horizontal(
        rrb.Vertical(floor, text, row_shares=[3, 2]),
        rrb.Vertical(*rows, row_shares=[3, 2]),
        column_shares=[3, 4],
        name="Worst places",
    )


def _drive(space: FreeSpace, pictures: Mapping[str, str], drive_s: float) -> rrb.Horizontal:
    room = rrb.Spatial3DView(
        name="Robot and path so far",
        origin="world",
        contents=["world/room", "world/drive/**"],
        eye_controls=aim_eye(space, tilt=0.45, reach=1.3, before=-0.4),
        line_grid=False,
        overrides={**hold_still(), "world/drive/path": rrb.VisibleTimeRanges(until_now())},
    )
    return rrb.Horizontal(
        room,
        rrb.Vertical(
            *camera_views(pictures),
            rrb.Horizontal(_segment_error(drive_s), ticks_view(drive_s)),
            row_shares=[*([3] if LARGE in pictures else []), *([2] if set(pictures) - {LARGE} else []), 2],
        ),
        column_shares=[5, 4],
        name="Drive",
    )


def camera_views(pictures: Mapping[str, str]) -> list[rrb.View | rrb.Container]:
    """Views of the sensors' pictures by their titles: those drawn for people above the others."""
    views = {name: rrb.Spatial2DView(name=title, origin=f"drive/{name}") for name, title in pictures.items()}
    large = [views.pop(LARGE)] if LARGE in views else []
    shares = [1 if name == "fisheye" else 2 for name in views]
    return [*large, *([rrb.Horizontal(*views.values(), column_shares=shares)] if views else [])]


def _encoders(space: FreeSpace, drive_s: float) -> rrb.Horizontal:
    """The encoders' errors: in words, as paths on the floor, along the drive, and for each segment."""
    lately = rrb.VisibleTimeRanges(_lately(TRAIL_S, drive_s))
    paths = rrb.Spatial3DView(
        name="True path (blue) and dead-reckoned path (orange)",
        origin="world",
        contents=["world/floor_plan", "world/drive/**", "world/reckoned/**"],
        eye_controls=aim_eye(space, reach=1.5, before=0.0),
        line_grid=False,
        overrides={**hold_still(), "world/drive/path": lately, "world/reckoned/path": lately},
    )
    return rrb.Horizontal(
        rrb.Vertical(paths, rrb.TextDocumentView(name="Faults", origin="encoders/faults"), row_shares=[5, 6]),
        rrb.Vertical(
            rrb.Horizontal(
                _segment_error(drive_s),
                ticks_view(drive_s),
                series_view("Ticks per gap, right minus left", "drive/tick_difference", RECENT_S, drive_s),
            ),
            rrb.Horizontal(
                series_view("Its sum over all segments [mm]", "drive/difference"),
                series_view("Dead-reckoning drift [m]", "encoders/drift"),
            ),
            rrb.Spatial2DView(name="Each segment", origin="encoders/segments"),
            row_shares=[4, 4, 6],
        ),
        column_shares=[5, 8],
        name="Encoders",
    )


def series_view(name: str, path: str, lately_s: float | None = None, drive_s: float = 0.0) -> rrb.TimeSeriesView:
    """A plot along the slider, of everything or of the last seconds, whose name says what a legend would."""
    return rrb.TimeSeriesView(
        name=name,
        origin=path,
        plot_legend=rrb.PlotLegend(visible=False),
        axis_x=whole_axis() if lately_s is None else None,
        time_ranges=None if lately_s is None else _lately(lately_s, drive_s),
    )


def _segment_error(drive_s: float) -> rrb.TimeSeriesView:
    return series_view("Encoder minus truth [mm]", "drive/segment_error", RECENT_S, drive_s)


def ticks_view(drive_s: float) -> rrb.TimeSeriesView:
    """The ticks of both wheels from reading to reading."""
    return series_view("Ticks per gap: left blue, right green", "drive/ticks", RECENT_S, drive_s)


def loss_view(name: str) -> rrb.TimeSeriesView:
    """A training's loss."""
    return series_view("Loss, log10: each step pale, running median bright", f"training/{name}")


def _training(space: FreeSpace, trained: Sequence[str]) -> rrb.Vertical:
    maps = [
        rrb.Spatial3DView(
            name=f"{title_of(name)}: map of the training images",
            origin="world",
            contents=["world/outline", f"world/training/{name}"],
            eye_controls=aim_eye(space, reach=0.85, before=0.0),
            line_grid=False,
            overrides=hold_still(),
        )
        for name in trained
    ]
    errors = [
        rrb.Spatial3DView(
            name=f"{title_of(name)}: errors on the training images",
            origin="world",
            contents=["world/outline", "world/scale/**", f"world/training_error/{name}/**"],
            eye_controls=aim_eye(space),
            line_grid=False,
            overrides=hold_still(),
        )
        for name in trained
    ]
    losses = [loss_view(name) for name in trained]
    return rrb.Vertical(
        *(rrb.Horizontal(*row) for row in (maps, errors, losses)), row_shares=[5, 6, 4], name="Training"
    )


def _report() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(name="Report", origin="report/text"),
        rrb.Vertical(
            distribution_view(),
            rrb.TextDocumentView(name="The place at the slider", origin="place/text"),
            row_shares=[3, 2],
        ),
        column_shares=[2, 3],
        name="Report",
    )


def whole_axis() -> rrb.TimeAxis:
    """Show a plot from its first to its last value."""
    infinite = rr.TimeRangeBoundary.infinite
    return rrb.TimeAxis(view_range=rr.TimeRange(start=infinite(), end=infinite()))


def until_now() -> list[rrb.VisibleTimeRange]:
    """Show what was logged from the start to the slider."""
    infinite = rr.TimeRangeBoundary.infinite
    return _since(infinite(), infinite())


def _lately(seconds: float, drive_s: float) -> list[rrb.VisibleTimeRange]:
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
