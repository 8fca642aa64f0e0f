"""The viewer's layout for a run: its tabs and their contents, of a finished run and of one in progress."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.viewer.error_field import COVERAGE, DENSITY, name_layer
from deepgps.viewer.pictures import LARGE
from deepgps.viewer.plot import distribution_view
from deepgps.viewer.run.drive import DIAGNOSIS, POLAR_PICTURES
from deepgps.viewer.run.making import MAKING, TEXT
from deepgps.viewer.run.places import PICTURES
from deepgps.viewer.timeline import PROGRESS, RUN_TIME, lately, until_now
from deepgps.viewer.views import aim_eye, aim_eye_at, arrange, field_view, room_view, series_view, text_view
from sim.geometry import FreeSpace

RECENT_S, TRAIL_S = 60.0, 120.0
PICTURE_TITLES = {
    "round": ("Test image, white", "Alike 1, yellow", "Alike 2, yellow", "Closest, green"),
    "polar": ("Test image, polar", "Alike 1, polar", "Alike 2, polar", "Closest, polar"),
}
STEPS, FIGURES = "steps", "report/figures"
Layers = Mapping[str, Sequence[str]]
"""Layers of a method's error field that are hidden at first, by method."""


def make_blueprint(
    space: FreeSpace,
    layers: Layers,
    trained: Sequence[str],
    pictures: Mapping[str, str],
    drive_s: float,
    mapped: str | None = None,
) -> rrb.Blueprint:
    """The viewer's layout for a finished run, which opens with what matters most.

    Args:
        space: The room's floor.
        layers: Measured methods, and their entities that are hidden at first.
        trained: Methods with a training history.
        pictures: Titles of the sensors' pictures, by name.
        drive_s: Duration of the drive [s].
        mapped: Method whose initial map's making is shown; None: no method kept it.
    """
    errors = rrb.Horizontal(_segment_error(drive_s), _ticks_view(drive_s))
    return arrange(
        [
            _error_fields(space, layers, ["place/test/**"]),
            _worst_places(space, "polar" in pictures),
            _drive(space, pictures, errors),
            *([_making(space, mapped)] if mapped else []),
            *([_training(space, trained, [_loss_view(name) for name in trained])] if trained else []),
            _encoders(space, drive_s),
            _report(),
        ],
        # opens at the end of drive and training
        rrb.TimePanel(state="collapsed", timeline=PROGRESS, play_state="following"),
    )


def make_live_blueprint(
    space: FreeSpace | None, pictures: bool, trained: Sequence[str], began_s: float, layers: Layers
) -> rrb.Blueprint:
    """The viewer's layout for a run in progress: a tab for each stage so far, with the newest in front.

    Args:
        space: The room's floor, once the recording is finished.
        pictures: Whether the robot has a camera.
        trained: Methods whose training has begun.
        began_s: When the first training began [s].
        layers: Methods whose error fields are available, and their entities that are hidden at first.
    """
    steps = text_view("Steps", STEPS)
    tabs: list[rrb.Container] = [_drive(space, POLAR_PICTURES if pictures else {}, steps, [RUN_TIME])]
    if space and trained:
        start = rr.TimeRangeBoundary.absolute(seconds=began_s)
        since = rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=rr.TimeRangeBoundary.infinite()))
        tabs.append(_training(space, trained, [*(_loss_view(name, since) for name in trained), steps]))
    if space and layers:
        tabs.append(_error_fields(space, layers))
    return arrange(tabs, rrb.TimePanel(state="collapsed", timeline=RUN_TIME, play_state="following"), len(tabs) - 1)


def make_blueprint_without_truth(
    pictures: Mapping[str, str], drive_s: float, reckoned: np.ndarray, last: Mapping[str, np.ndarray]
) -> rrb.Blueprint:
    """The viewer's layout for a run without truth.

    Args:
        pictures: As in ``make_blueprint``.
        drive_s: Likewise.
        reckoned: The dead-reckoned path (R, 2) [m].
        last: The methods' last maps (n, 2) [m].
    """
    path = rrb.Spatial3DView(
        name="Dead-reckoned path",
        origin="world",
        eye_controls=_aim_at(reckoned),
        overrides={"world/reckoned/path": rrb.VisibleTimeRanges(until_now())},
    )
    beside = rrb.Vertical(
        *_camera_views(pictures),
        series_view("Distance travelled [m]", "drive/distance"),
        _ticks_view(drive_s),
        rrb.Tabs(text_view("Without truth", "report"), _diagnosis_view()),
    )
    tabs: list[rrb.Horizontal | rrb.Vertical] = [rrb.Horizontal(path, beside, name="Drive", column_shares=[3, 2])]
    if last:
        maps = [
            rrb.Spatial3DView(name=title_of(name), origin=f"map/{name}", eye_controls=_aim_at(points, len(last)))
            for name, points in last.items()
        ]
        losses = [_loss_view(name) for name in last]
        tabs.append(rrb.Vertical(rrb.Horizontal(*maps), rrb.Horizontal(*losses), name="Training", row_shares=[3, 1]))
    return arrange(tabs, rrb.TimePanel(state="collapsed", timeline=PROGRESS, play_state="following"))


def _camera_views(pictures: Mapping[str, str]) -> list[rrb.View | rrb.Container]:
    """Views of the sensors' pictures by their titles: those drawn for people above the others."""
    views = {name: rrb.Spatial2DView(name=title, origin=f"drive/{name}") for name, title in pictures.items()}
    large = [views.pop(LARGE)] if LARGE in views else []
    shares = [1 if name == "fisheye" else 2 for name in views]
    return [*large, *([rrb.Horizontal(*views.values(), column_shares=shares)] if views else [])]


def _diagnosis_view() -> rrb.TextDocumentView:
    return text_view("Diagnosis of the wheels", DIAGNOSIS)


def _ticks_view(drive_s: float) -> rrb.TimeSeriesView:
    return series_view("Ticks per gap: left blue, right green", "drive/ticks", RECENT_S, drive_s)


def _loss_view(name: str, since: rrb.TimeAxis | None = None) -> rrb.TimeSeriesView:
    title = "Loss, log10: each step pale, running median bright"
    return series_view(title, f"training/{name}", since=since)


def _error_fields(space: FreeSpace, layers: Layers, places: Sequence[str] = ()) -> rrb.Horizontal | rrb.Vertical:
    """The first method's error field in the furnished room, all figures, and the other methods' fields as plans."""
    first, *others = layers
    coverage = [path.removeprefix("world/") for path in (COVERAGE, DENSITY)]
    hidden = {method: [*paths, COVERAGE, DENSITY] for method, paths in layers.items()}
    around = ["floor_plan", "scale/**", *places, *coverage]
    wide = len(others) > 1  # plans below leave less height
    oblique, above = aim_eye(space, tilt=0.45, reach=1.08), aim_eye(space, reach=0.85 if wide else 1.0)
    room = rrb.Tabs(
        field_view(f"Error field of {title_of(first)}", first, oblique, ["room", *around], hidden[first]),
        field_view("From above", first, above, around, hidden[first]),
        active_tab=0,
    )
    eye = aim_eye(space, reach=0.85, before=0.0)
    plans = [field_view(title_of(name), name, eye, ["floor_plan", *coverage], hidden[name]) for name in others]
    figures = text_view("Figures", FIGURES)
    if not wide:
        return rrb.Horizontal(room, rrb.Vertical(figures, *plans), column_shares=[5, 2], name="Error field")
    above_all = rrb.Horizontal(room, figures, column_shares=[5, 2])
    return rrb.Vertical(above_all, rrb.Horizontal(*plans), row_shares=[5, 3], name="Error field")


def _worst_places(space: FreeSpace, pictures: bool) -> rrb.Container:
    """One of the worst places: its test image beside training images, its place on the floor plan, and its numbers."""
    name = "Worst places"
    floor = room_view(
        "The place, and where the training images were taken",
        [
            *("floor_plan", "outline", "place/radius"),
            *("place/error", "place/test"),  # labels are few as it is
            *(f"place/{picture}/**" for picture in PICTURES[1:]),
        ],
        aim_eye(space, reach=0.9, before=0.0),
    )
    texts = [text_view("Place", "place/text"), text_view("Training images", "place/taken")]
    if not pictures:
        return rrb.Horizontal(floor, rrb.Vertical(*texts, row_shares=[3, 2]), column_shares=[5, 3], name=name)
    rows = [
        rrb.Horizontal(
            *(
                rrb.Spatial2DView(name=title, origin=f"place/{picture}/{kind}")
                for title, picture in zip(titles, PICTURES, strict=True)
            )
        )
        for kind, titles in PICTURE_TITLES.items()
    ]
    below = rrb.Horizontal(floor, *texts, column_shares=[5, 5, 4])
    return rrb.Vertical(*rows, below, row_shares=[10, 3, 9], name=name)


def _drive(
    space: FreeSpace | None,
    pictures: Mapping[str, str],
    below: rrb.View | rrb.Container,
    timelines: Sequence[str] | None = None,
) -> rrb.Horizontal:
    """The robot in the room beside its pictures, with something below them."""
    ranges = until_now(timelines) if timelines else until_now()
    room = room_view(
        "Robot and path so far",
        ["room", "drive/**"],
        aim_eye(space, tilt=0.45, reach=1.3, before=-0.4),
        overrides={"world/drive/path": rrb.VisibleTimeRanges(ranges)},
        line_grid=space is None,
    )
    shares = [*([3] if LARGE in pictures else []), *([2] if set(pictures) - {LARGE} else []), 2]
    beside = rrb.Vertical(*_camera_views(pictures), below, row_shares=shares)
    return rrb.Horizontal(room, beside, column_shares=[5, 4], name="Drive")


def _making(space: FreeSpace, method: str) -> rrb.Horizontal:
    """How the initial map is made, and the errors that it expects beside those of the trained method."""
    making = room_view(
        "The initial map in the making: choose the timeline `making`",
        ["outline", f"{MAKING.removeprefix('world/')}/**"],
        aim_eye(space, before=0.0),
    )
    fields = [
        room_view(name, ["floor_plan", "scale/**", shown.removeprefix("world/")], aim_eye(space, reach=0.9))
        for name, shown in (
            ("Error that the initial map expects of itself", name_layer(method, "expected")),
            (f"Error field of {title_of(method)}", name_layer(method, "worst/**")),
        )
    ]
    beside = rrb.Vertical(text_view("This stage", TEXT), *fields, row_shares=[4, 4, 4])
    return rrb.Horizontal(making, beside, column_shares=[5, 3], name="Initial map")


def _encoders(space: FreeSpace, drive_s: float) -> rrb.Horizontal:
    """The encoders' errors: in words, as paths on the floor, along the drive, and for each segment."""
    trail = rrb.VisibleTimeRanges(lately(TRAIL_S, drive_s))
    paths = room_view(
        "True path (blue) and dead-reckoned path (orange)",
        ["floor_plan", "drive/**", "reckoned/**"],
        aim_eye(space, reach=1.5, before=0.0),
        overrides={"world/drive/path": trail, "world/reckoned/path": trail},
    )
    faults = text_view("Faults that were set", "encoders/faults")
    return rrb.Horizontal(
        rrb.Vertical(paths, rrb.Tabs(_diagnosis_view(), faults, active_tab=0), row_shares=[5, 6]),
        rrb.Vertical(
            rrb.Horizontal(
                _segment_error(drive_s),
                _ticks_view(drive_s),
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


def _segment_error(drive_s: float) -> rrb.TimeSeriesView:
    return series_view("Encoder minus truth [mm]", "drive/segment_error", RECENT_S, drive_s)


def _training(space: FreeSpace, trained: Sequence[str], losses: Sequence[rrb.View]) -> rrb.Vertical:
    eye = aim_eye(space, reach=0.85, before=0.0)
    maps = [
        room_view(f"{title_of(name)}: map of the training images", ["outline", f"training/{name}"], eye)
        for name in trained
    ]
    errors = [
        room_view(
            f"{title_of(name)}: errors on the training images",
            ["outline", "scale/**", f"training_error/{name}/**"],
            aim_eye(space),
        )
        for name in trained
    ]
    rows = [rrb.Horizontal(*row) for row in (maps, errors, losses)]
    return rrb.Vertical(*rows, row_shares=[5, 6, 4], name="Training")


def _report() -> rrb.Horizontal:
    beside = rrb.Vertical(distribution_view(), text_view("The place at the slider", "place/text"), row_shares=[3, 2])
    return rrb.Horizontal(text_view("Report", "report/text"), beside, column_shares=[2, 3], name="Report")


def _aim_at(points: np.ndarray, views: int = 1) -> rrb.EyeControls3D:
    """Place the eye above points (n, 2) [m] in one of several views side by side."""
    return aim_eye_at(points.min(axis=0), points.max(axis=0), reach=max(1.2, 0.55 * views))
