"""The viewer's layout for a run: its tabs and their contents."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.figures import field_plot
from deepgps.methods.catalog import title_of
from deepgps.viewer.timeline import DRIVE_TIME, PROGRESS, PROGRESS_END
from sim.occupancy import FreeSpace

RECENT_S, TRAIL_S = 60.0, 120.0


def make_blueprint(
    space: FreeSpace,
    methods: Sequence[str],
    trained: Sequence[str],
    pictures: Mapping[str, str],
    drive_s: float,
) -> rrb.Blueprint:
    """The viewer's layout for a run, which opens with what matters most.

    Args:
        space: The room's floor.
        methods: Measured methods.
        trained: Methods with a training history.
        pictures: Titles of the sensors' pictures, by name.
        drive_s: Duration of the drive [s].
    """
    return rrb.Blueprint(
        rrb.Tabs(
            _error_fields(space, methods),
            _drive(space, pictures, drive_s),
            *([_training(space, trained)] if trained else []),
            _encoders(space, drive_s),
            _report(trained),
            active_tab=0,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # opens at the end of drive and training; playing everything takes a hundred seconds
        rrb.TimePanel(state="collapsed", timeline=PROGRESS, fps=PROGRESS_END / 100, play_state="following"),
        auto_views=False,
    )


def _error_fields(space: FreeSpace, methods: Sequence[str]) -> rrb.Horizontal | rrb.Vertical:
    """The first method's error field in the furnished room, all figures, and the other methods' fields as plans."""
    first, *others = methods
    room = rrb.Spatial3DView(
        name=f"Error field of {title_of(first)}",
        origin="world",
        contents=["world/room", "world/floor_plan", "world/scale/**", f"world/error_field/{first}/**"],
        eye_controls=aim_eye(space, tilt=0.45, reach=1.08),
        line_grid=False,
    )
    plans = [
        rrb.Spatial3DView(
            name=title_of(method),
            origin="world",
            contents=["world/floor_plan", f"world/error_field/{method}/**"],
            eye_controls=aim_eye(space, reach=0.85, before=0.0),
            line_grid=False,
        )
        for method in others
    ]
    figures_of_all = rrb.TextDocumentView(name="Figures", origin="report/figures")
    if len(plans) < 2:
        beside = rrb.Vertical(figures_of_all, *plans)
        return rrb.Horizontal(room, beside, column_shares=[5, 2], name="Error field")
    above = rrb.Horizontal(room, figures_of_all, column_shares=[5, 2])
    return rrb.Vertical(above, rrb.Horizontal(*plans), row_shares=[5, 3], name="Error field")


def _drive(space: FreeSpace, pictures: Mapping[str, str], drive_s: float) -> rrb.Horizontal:
    room = rrb.Spatial3DView(
        name="Robot and path so far",
        origin="world",
        contents=["world/room", "world/drive/**"],
        eye_controls=aim_eye(space, tilt=0.45, reach=1.3, before=-0.4),
        line_grid=False,
        overrides={"world/drive/path": rrb.VisibleTimeRanges(_until_now())},
    )
    cameras = rrb.Horizontal(
        *(rrb.Spatial2DView(name=title, origin=f"drive/{name}") for name, title in pictures.items()),
        column_shares=[1 if name == "fisheye" else 2 for name in pictures],
    )
    return rrb.Horizontal(
        room,
        rrb.Vertical(
            *([cameras] if pictures else []),
            _distances(drive_s),
            _ticks(drive_s),
            row_shares=[1] * (3 if pictures else 2),
        ),
        column_shares=[5, 4],
        name="Drive",
    )


def _encoders(space: FreeSpace, drive_s: float) -> rrb.Horizontal:
    """The encoders' errors: in words, as paths on the floor, along the drive, and for each segment."""
    lately = rrb.VisibleTimeRanges(_lately(TRAIL_S, drive_s))
    paths = rrb.Spatial3DView(
        name="True path (blue) and dead-reckoned path (orange)",
        origin="world",
        contents=["world/floor_plan", "world/drive/**", "world/reckoned/**"],
        eye_controls=aim_eye(space, reach=1.5, before=0.0),
        line_grid=False,
        overrides={"world/drive/path": lately, "world/reckoned/path": lately},
    )
    return rrb.Horizontal(
        rrb.Vertical(paths, rrb.TextDocumentView(name="Faults", origin="encoders/faults"), row_shares=[5, 6]),
        rrb.Vertical(
            rrb.Horizontal(_distances(drive_s), _ticks(drive_s)),
            rrb.Horizontal(
                rrb.TimeSeriesView(
                    name="Encoder minus truth, cumulative [mm]", origin="drive/difference", axis_x=whole_axis()
                ),
                rrb.TimeSeriesView(name="Dead-reckoning drift [m]", origin="encoders/drift", axis_x=whole_axis()),
            ),
            rrb.Spatial2DView(name="Each segment", origin="encoders/segments"),
            row_shares=[4, 4, 6],
        ),
        column_shares=[5, 8],
        name="Encoders",
    )


def _distances(drive_s: float) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        name="Distance on this segment [m]", origin="drive/distance", time_ranges=_lately(RECENT_S, drive_s)
    )


def _ticks(drive_s: float) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name="Ticks", origin="drive/ticks", time_ranges=_lately(RECENT_S, drive_s))


def _training(space: FreeSpace, trained: Sequence[str]) -> rrb.Vertical:
    maps = [
        rrb.Spatial3DView(
            name=f"{title_of(name)}: map of the training images",
            origin="world",
            contents=["world/outline", f"world/training/{name}"],
            eye_controls=aim_eye(space, reach=0.85, before=0.0),
            line_grid=False,
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
        )
        for name in trained
    ]
    losses = [
        rrb.TimeSeriesView(name="Loss, log10", origin=f"training/{name}", axis_x=whole_axis()) for name in trained
    ]
    return rrb.Vertical(
        *(rrb.Horizontal(*row) for row in (maps, errors, losses)), row_shares=[5, 6, 4], name="Training"
    )


def _report(trained: Sequence[str]) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(name="Report", origin="report/text"),
        rrb.Tabs(
            rrb.Spatial2DView(name="Error fields", origin="report/error_fields"),
            rrb.Spatial2DView(name="Error distribution", origin="report/error_cdf"),
            *([rrb.Spatial2DView(name="Training", origin="report/training")] if trained else []),
        ),
        column_shares=[2, 3],
        name="Report",
    )


def whole_axis() -> rrb.TimeAxis:
    """A time axis that shows a series from its first to its last value."""
    infinite = rr.TimeRangeBoundary.infinite
    return rrb.TimeAxis(view_range=rr.TimeRange(start=infinite(), end=infinite()))


def _until_now() -> list[rrb.VisibleTimeRange]:
    infinite = rr.TimeRangeBoundary.infinite
    return _since(infinite(), infinite())


def _lately(seconds: float, drive_s: float) -> list[rrb.VisibleTimeRange]:
    """Show the last seconds [s] of the drive, also on the timeline ``progress``, on which the drive is rescaled."""
    relative, share = rr.TimeRangeBoundary.cursor_relative, seconds / max(drive_s, seconds)
    return _since(relative(seconds=-seconds), relative(seq=-round(PROGRESS_END * share)))


def _since(drive_time: rr.TimeRangeBoundary, progress: rr.TimeRangeBoundary) -> list[rrb.VisibleTimeRange]:
    relative = rr.TimeRangeBoundary.cursor_relative
    return [
        rrb.VisibleTimeRange(DRIVE_TIME, start=drive_time, end=relative(seconds=0)),
        rrb.VisibleTimeRange(PROGRESS, start=progress, end=relative(seq=0)),
    ]


def aim_eye(space: FreeSpace, tilt: float = 0.0, reach: float = 1.0, before: float = 0.25) -> rrb.EyeControls3D:
    """Place the eye above the room, with space for the scale in front of it.

    Args:
        space: The room's floor.
        tilt: How far the eye is tilted to the south [rad].
        reach: Distance of the eye, as a multiple of the distance at which the plan is visible.
        before: How far south of the room's middle the eye looks [m].
    """
    low, high = field_plot.limits(space)
    middle = np.array([*(low + high) / 2, 0.0]) - [0, before, 0]
    distance = reach * (1.2 * max(high[1] - low[1], 0.62 * (high[0] - low[0])) + (0.8 if before else 0.1))
    away = distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    # an eye exactly above the room has no up direction of its own, so north is up
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=middle + away, look_target=middle, eye_up=(0.0, 1.0, 0.0)
    )
