"""The viewer's layout for a run: its tabs and their contents."""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.viewer.distribution import distribution_view
from deepgps.viewer.run.coverage import COVERAGE, DENSITY
from deepgps.viewer.run.diagnosis import diagnosis_view
from deepgps.viewer.run.making import MAKING, TEXT, name_expected
from deepgps.viewer.run.pictures import LARGE
from deepgps.viewer.run.place_drawing import PICTURES
from deepgps.viewer.timeline import PROGRESS
from deepgps.viewer.views import aim_eye, arrange, field_view, hold_still, lately, series_view, until_now
from sim.occupancy import FreeSpace

RECENT_S, TRAIL_S = 60.0, 120.0
PICTURE_TITLES = {
    "round": ("Test image, white", "Alike 1, yellow", "Alike 2, yellow", "Closest, green"),
    "polar": ("Test image, polar", "Alike 1, polar", "Alike 2, polar", "Closest, polar"),
}
Headings = Mapping[str, Sequence[str]]
"""Entities of a method's error field that are hidden at first, by method: errors at each heading, and yaws."""


def make_blueprint(
    space: FreeSpace,
    headings: Headings,
    trained: Sequence[str],
    pictures: Mapping[str, str],
    drive_s: float,
    mapped: str | None = None,
) -> rrb.Blueprint:
    """The viewer's layout for a run, which opens with what matters most.

    Args:
        space: The room's floor.
        headings: Measured methods, and their entities that are hidden at first.
        trained: Methods with a training history.
        pictures: Titles of the sensors' pictures, by name.
        drive_s: Duration of the drive [s].
        mapped: Method whose initial map's making is shown; None: no method kept it.
    """
    return arrange(
        [
            _error_fields(space, headings),
            _worst_places(space, "polar" in pictures),
            _drive(space, pictures, drive_s),
            *([_making(space, mapped)] if mapped else []),
            *([_training(space, trained)] if trained else []),
            _encoders(space, drive_s),
            _report(),
        ],
        # opens at the end of drive and training
        rrb.TimePanel(state="collapsed", timeline=PROGRESS, play_state="following"),
    )


def _error_fields(space: FreeSpace, headings: Headings) -> rrb.Horizontal | rrb.Vertical:
    """The first method's error field in the furnished room, all figures, and the other methods' fields as plans."""
    first, *others = headings
    layers = [path.removeprefix("world/") for path in (COVERAGE, DENSITY)]
    hidden = {method: [*paths, COVERAGE, DENSITY] for method, paths in headings.items()}
    around = ["floor_plan", "scale/**", "place/test/**", *layers]
    wide = len(others) > 1  # plans below leave less height
    oblique, above = aim_eye(space, tilt=0.45, reach=1.08), aim_eye(space, reach=0.85 if wide else 1.0)
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
    if not wide:
        beside = rrb.Vertical(figures_of_all, *plans)
        return rrb.Horizontal(room, beside, column_shares=[5, 2], name="Error field")
    above_all = rrb.Horizontal(room, figures_of_all, column_shares=[5, 2])
    return rrb.Vertical(above_all, rrb.Horizontal(*plans), row_shares=[5, 3], name="Error field")


def _worst_places(space: FreeSpace, pictures: bool) -> rrb.Container:
    """One of the worst places: its test image beside training images, its place on the floor plan, and its numbers."""
    name = "Worst places"
    floor = rrb.Spatial3DView(
        name="The place, and where the training images were taken",
        origin="world",
        contents=[
            *("world/floor_plan", "world/outline", "world/place/radius"),
            *("world/place/error", "world/place/test"),  # labels are few as it is
            *(f"world/place/{picture}/**" for picture in PICTURES[1:]),
        ],
        eye_controls=aim_eye(space, reach=0.9, before=0.0),
        line_grid=False,
        overrides=hold_still(),
    )
    texts = [
        rrb.TextDocumentView(name="Place", origin="place/text"),
        rrb.TextDocumentView(name="Training images", origin="place/taken"),
    ]
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


def _making(space: FreeSpace, method: str) -> rrb.Horizontal:
    """How the initial map is made, and the errors that it expects beside those of the trained method."""
    eye = aim_eye(space, reach=1.0, before=0.0)
    making = rrb.Spatial3DView(
        name="The initial map in the making: choose the timeline `making`",
        origin="world",
        contents=["world/outline", f"{MAKING}/**"],
        eye_controls=eye,
        line_grid=False,
        overrides=hold_still(),
    )
    fields = [
        rrb.Spatial3DView(
            name=name,
            origin="world",
            contents=["world/floor_plan", "world/scale/**", *contents],
            eye_controls=aim_eye(space, reach=0.9),
            line_grid=False,
            overrides=hold_still(),
        )
        for name, contents in (
            ("Error that the initial map expects of itself", [name_expected(method)]),
            (f"Error field of {title_of(method)}", [f"world/error_field/{method}/worst/**"]),
        )
    ]
    text = rrb.TextDocumentView(name="This stage", origin=TEXT)
    return rrb.Horizontal(
        making, rrb.Vertical(text, *fields, row_shares=[4, 4, 4]), column_shares=[5, 3], name="Initial map"
    )


def _encoders(space: FreeSpace, drive_s: float) -> rrb.Horizontal:
    """The encoders' errors: in words, as paths on the floor, along the drive, and for each segment."""
    trail = rrb.VisibleTimeRanges(lately(TRAIL_S, drive_s))
    paths = rrb.Spatial3DView(
        name="True path (blue) and dead-reckoned path (orange)",
        origin="world",
        contents=["world/floor_plan", "world/drive/**", "world/reckoned/**"],
        eye_controls=aim_eye(space, reach=1.5, before=0.0),
        line_grid=False,
        overrides={**hold_still(), "world/drive/path": trail, "world/reckoned/path": trail},
    )
    faults = rrb.TextDocumentView(name="Faults that were set", origin="encoders/faults")
    return rrb.Horizontal(
        rrb.Vertical(paths, rrb.Tabs(diagnosis_view(), faults, active_tab=0), row_shares=[5, 6]),
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
