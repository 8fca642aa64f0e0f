"""The viewer's layout for a run in progress: a tab for each stage, with the newest in front."""

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.viewer.run.drive import POLAR_PICTURES
from deepgps.viewer.views import aim_eye, arrange, field_view, hold_still
from sim.occupancy import FreeSpace

RUN_TIME = "run_time"
EYE = rrb.EyeControls3D(
    kind=rrb.Eye3DKind.Orbital, position=(0.0, -3.0, 6.4), look_target=(0.0, -0.3, 0.0), eye_up=(0.0, 1.0, 0.0)
)
"""View until the room is known: it shows all of a room of usual size."""


def make_live_blueprint(
    space: FreeSpace | None, pictures: bool, trained: Sequence[str], began_s: float, measured: Sequence[str]
) -> rrb.Blueprint:
    """The viewer's layout for the data so far.

    Args:
        space: The room's floor, once the recording is finished.
        pictures: Whether the robot has a camera.
        trained: Methods whose training has begun.
        began_s: When the first training began [s].
        measured: Methods whose error fields are available.
    """
    tabs: list[rrb.Container] = [_drive(space, pictures)]
    if space and trained:
        tabs.append(_training(space, trained, began_s))
    if space and measured:
        tabs.append(_error_fields(space, measured))
    time = rrb.TimePanel(state="collapsed", timeline=RUN_TIME, play_state="following")
    return arrange(tabs, time, len(tabs) - 1)


def _drive(space: FreeSpace | None, pictures: bool) -> rrb.Horizontal:
    until_now = rr.VisibleTimeRange(
        RUN_TIME, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.cursor_relative(seconds=0)
    )
    room = rrb.Spatial3DView(
        name="Robot and segments so far",
        origin="world",
        contents=["world/room", "world/drive/**"],
        eye_controls=aim_eye(space, tilt=0.45, reach=1.3, before=-0.4) if space else EYE,
        line_grid=space is None,
        overrides={**hold_still(), "world/drive/path": rrb.VisibleTimeRanges([until_now])},
    )
    seen = POLAR_PICTURES if pictures else {}
    views = [rrb.Spatial2DView(name=title, origin=f"drive/{name}") for name, title in seen.items()]
    return rrb.Horizontal(
        room,
        rrb.Vertical(*views, _steps(), row_shares=[*([4, 2] if pictures else []), 3]),
        column_shares=[5, 2],
        name="Drive",
    )


def _training(space: FreeSpace, trained: Sequence[str], began_s: float) -> rrb.Vertical:
    maps = [
        rrb.Spatial3DView(
            name=f"{title_of(name)}: map of the training images",
            origin="world",
            contents=["world/floor_plan", "world/outline", f"world/training/{name}"],
            eye_controls=aim_eye(space, reach=0.9),
            line_grid=False,
            overrides=hold_still(),
        )
        for name in trained
    ]
    since = rr.TimeRange(start=rr.TimeRangeBoundary.absolute(seconds=began_s), end=rr.TimeRangeBoundary.infinite())
    losses = rrb.TimeSeriesView(name="Loss, log10", origin="training", axis_x=rrb.TimeAxis(view_range=since))
    return rrb.Vertical(
        rrb.Horizontal(*maps),
        rrb.Horizontal(losses, _steps(), column_shares=[5, 2]),
        row_shares=[3, 2],
        name="Training",
    )


def _error_fields(space: FreeSpace, measured: Sequence[str]) -> rrb.Horizontal:
    fields = [
        field_view(
            f"Error field of {title_of(name)}",
            name,
            aim_eye(space, tilt=0.45, reach=1.08),
            ["room", "floor_plan", "scale/**"],
        )
        for name in measured
    ]
    return rrb.Horizontal(
        rrb.Grid(*fields, grid_columns=1 if len(fields) == 1 else 2),
        rrb.TextDocumentView(name="Figures", origin="report/figures"),
        column_shares=[5, 2],
        name="Error field",
    )


def _steps() -> rrb.TextDocumentView:
    return rrb.TextDocumentView(name="Steps", origin="steps")
