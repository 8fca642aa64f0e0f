"""The viewer's layouts: the tabs of a run, finished or in progress, and the views that all layouts use."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.viewer.drive import DIAGNOSIS
from deepgps.viewer.error_field import ELLIPSE_SCALE, TRUST
from deepgps.viewer.making import MAP_ENTITY, TEXT_ENTITY
from deepgps.viewer.pictures import POLAR_PICTURES
from deepgps.viewer.scene import BACKDROP, LAYER_M, STILL_BEHAVIOUR
from deepgps.viewer.stream import DEPLOYMENT, DRIVE_TIME, show_until_now

TICK_WINDOW_S, TRAIL_S = 60.0, 120.0
ASPECT = 1.6  # Width of most views over their height
PICTURE_TITLES = {
    "test": "Test image, white",
    "weight": "What differs, magenta",
    "answer_1": "At the answer 1, yellow",
    "answer_2": "At the answer 2, yellow",
    "closest": "Closest, green",
}
LOGARITHM = "0 is 1 cm, 1 is 10 cm, 2 is 1 m"  # What the values of a plot of errors mean
NIGHT = (13, 13, 13)  # Colour behind plans and rooms, in any theme
METRES = rrb.LineGrid3D(spacing=1.0, plane=rr.components.Plane3D.XY.with_distance(LAYER_M), color=(255, 255, 255, 25))
STEPS, FIGURES, REPORT, DISTRIBUTION = "steps", "report/figures", "report/text", "report/distribution"
Floor = tuple[np.ndarray, np.ndarray]  # South-west and north-east corners (2,) [m] of what an eye sees
Part = rrb.Container | rrb.View


def arrange(tabs: Sequence[Part], time: rrb.TimePanel, active: int = 0) -> rrb.Blueprint:
    """A layout of tabs between panels that are closed, since the tooltip says what the selection panel would."""
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=active),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
    )


def follow(timeline: str) -> rrb.TimePanel:
    """A closed time panel, whose slider stays at the end of a timeline."""
    return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following")


def pause(timeline: str, speed: float | None = None, fps: float | None = None) -> rrb.TimePanel:
    """A closed time panel, whose slider stands at the start of any timeline; in times or steps per second to play."""
    return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="paused", playback_speed=speed, fps=fps)


def room_view(
    name: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D,
    root: str = "world",
    overrides: Mapping[Any, Any] | None = None,
    line_grid: bool = False,
) -> rrb.Spatial3DView:
    """A dark view of entities below ``root``; only what can tell something catches the pointer; a plan has lines every
    metre, with numbers."""
    is_plan = "room" not in contents
    return rrb.Spatial3DView(
        name=name,
        origin=root,
        contents=[f"{root}/{one}" for one in (*contents, *(["metres"] if is_plan else []))],
        eye_controls=eye,
        line_grid=line_grid or (is_plan and METRES),
        background=NIGHT,
        overrides={f"{root}/{name}": STILL_BEHAVIOUR for name in BACKDROP} | dict(overrides or {}),
    )


def text_view(name: str, origin: str) -> rrb.TextDocumentView:
    """A view of one text."""
    return rrb.TextDocumentView(name=name, origin=origin)


def series_view(
    name: str, path: str, lately_s: float | None = None, start: Any = None, legend: bool = False
) -> rrb.TimeSeriesView:
    """A plot along the slider, of everything or of the last seconds; without a legend, its name says as much."""
    infinite = rr.TimeRangeBoundary.infinite()
    whole = rrb.TimeAxis(view_range=rr.TimeRange(start=start or infinite, end=infinite))
    return rrb.TimeSeriesView(
        name=name,
        origin=path,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
        axis_x=whole if lately_s is None else None,
        time_ranges=None if lately_s is None else show_until_now(seconds=lately_s),
    )


def aim_eye(
    floor: Floor | None, tilt: float = 0.0, reach: float = 1.0, before: float = 0.25, aspect: float = ASPECT
) -> rrb.EyeControls3D:
    """Place the eye above a floor, or above one of usual size, with space for the scale in front of it.

    It is tilted to the south [rad], ``reach`` times as far away as the plan needs, and looks south of the middle [m].
    The aspect is the view's width over its height.
    """
    low, high = floor or (np.full(2, -2.5), np.full(2, 2.5))
    middle = np.array([*(low + high) / 2, 0.0]) - [0, before, 0]
    depth = max(high[1] - low[1], (high[0] - low[0]) / min(aspect, ASPECT))
    distance = reach * (1.2 * depth + (0.8 if before else 0.3))
    position = middle + distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    # north is up, since an eye exactly above has no up direction of its own
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=middle, eye_up=(0.0, 1.0, 0.0))


def error_fields(floor: Floor, methods: Sequence[str], around: Sequence[str] = ()) -> Part:
    """The first method's error field in the furnished room, all figures, and the other methods' fields as plans."""
    first, *others = methods

    def field_view(name: str, method: str, eye: rrb.EyeControls3D, around: Sequence[str] = ()) -> rrb.Spatial3DView:
        return room_view(name, ["floor_plan", *around, f"error_field/{method}/**"], eye)

    scale, room_eye = ["scale/**", *around], aim_eye(floor, tilt=0.45, reach=1.08)
    room = rrb.Tabs(
        field_view(f"Error field of {title_of(first)}", first, room_eye, ["room", *scale]),
        field_view("From above", first, aim_eye(floor), scale),
        active_tab=0,
    )
    above = rrb.Horizontal(room, text_view("Figures", FIGURES), column_shares=[5, 2], name="Error field")
    if not others:
        return above
    eye = aim_eye(floor, before=0.0, aspect=4.8 / len(others))
    plans = [field_view(title_of(name), name, eye) for name in others]
    return rrb.Vertical(above, rrb.Horizontal(*plans), row_shares=[5, 3], name="Error field")


def places(floor: Floor, pictures: bool) -> Part:
    """One image at a time, beside training images, its place and its modes on the floor plan, and its numbers."""
    plan = room_view(
        "The place, and others that explain the image", ["floor_plan", "place/**"], aim_eye(floor, before=0.0)
    )
    below = rrb.Horizontal(plan, text_view("Place", "place/text"), name="Places")
    if not pictures:
        return below
    images = [rrb.Spatial2DView(name=name, origin=f"place/{one}") for one, name in PICTURE_TITLES.items()]
    return rrb.Vertical(rrb.Horizontal(*images), below, row_shares=[2, 3], name="Places")


def trust(floor: Floor, method: str) -> Part:
    """The radius that a method expects at each place, with ellipses."""
    title = f"{title_of(method)}: radius of 68 % (grey: refused), and ellipses of 95 %, {ELLIPSE_SCALE} times as large"
    shown = ["floor_plan", "radius_scale/**", f"{TRUST.removeprefix('world/')}/**"]
    return rrb.Horizontal(room_view(title, shown, aim_eye(floor)), name="Trust")


def deployment(floor: Floor, method: str, ways: Mapping[str, str], pictures: bool) -> Part:
    """The deployment drive in the colours of a method's errors along it, for each way of finding positions."""
    eye, around = aim_eye(floor, aspect=2.9 / len(ways)), ["floor_plan", "scale/**"]
    views = [
        room_view(f"{title_of(method)}: {title}", [*around, f"{DEPLOYMENT}/{name}/**"], eye)
        for name, title in ways.items()
    ]
    below: list[Part] = [series_view(f"Errors along the drive: {LOGARITHM}", f"{DEPLOYMENT}/error", legend=True)]
    below += picture_views(POLAR_PICTURES if pictures else {}, DEPLOYMENT)
    return rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*below), row_shares=[5, 3], name="Deployment")


def drive(
    floor: Floor | None,
    pictures: Mapping[str, str],
    below: Part,
    timeline: str = DRIVE_TIME,
    has_room: bool = True,
) -> Part:
    """The robot in its room, or on its path alone, what it sees, and something below."""
    room = room_view(
        "Robot and path so far",
        ["room", "drive/**"],
        aim_eye(floor, tilt=0.45, reach=1.3, before=-0.4),
        overrides={"world/drive/path": rrb.VisibleTimeRanges(show_until_now(timeline))},
        line_grid=not has_room,
    )
    images = picture_views(pictures, "drive")
    beside = rrb.Vertical(*([rrb.Horizontal(*images)] if images else []), below)
    return rrb.Horizontal(room, beside, column_shares=[5, 4], name="Drive")


def picture_views(pictures: Mapping[str, str], origin: str) -> list[rrb.View]:
    """Views of pictures below an entity, by their titles."""
    return [rrb.Spatial2DView(name=title, origin=f"{origin}/{name}") for name, title in pictures.items()]


def ticks_view() -> rrb.TimeSeriesView:
    """A plot of the ticks from reading to reading."""
    return series_view("Ticks per gap: left blue, right wide, green", "drive/ticks", TICK_WINDOW_S)


def segment_error_view() -> rrb.TimeSeriesView:
    """A plot of the encoders' errors along the segments."""
    return series_view("Encoder minus truth [mm]", "drive/segment_error", TICK_WINDOW_S)


def making(floor: Floor) -> Part:
    """The initial map in the making, and in words."""
    title = "The initial map: choose the timeline `making` to see how it is made"
    plan = room_view(
        title, ["floor_plan", f"{MAP_ENTITY.removeprefix('world/')}/**"], aim_eye(floor, before=0.0, aspect=1.2)
    )
    return rrb.Horizontal(plan, text_view("This stage", TEXT_ENTITY), column_shares=[5, 2], name="Initial map")


def encoders(floor: Floor) -> Part:
    """The encoders' errors: in words, as paths on the floor, along the drive, and for each segment."""
    trail = rrb.VisibleTimeRanges(show_until_now(seconds=TRAIL_S))
    paths = room_view(
        "True path (blue) and dead-reckoned path (orange)",
        ["floor_plan", "drive/**", "reckoned/**"],
        aim_eye(floor, reach=1.5, before=0.0),
        overrides={"world/drive/path": trail, "world/reckoned/path": trail},
    )
    series = rrb.Vertical(
        series_view("Ticks per gap, right minus left", "drive/tick_difference", TICK_WINDOW_S),
        series_view("Dead-reckoning drift [m]", "encoders/drift"),
        rrb.Spatial2DView(name="Each segment", origin="encoders/segments"),
        row_shares=[4, 4, 6],
    )
    faults = text_view("Faults that were set", "encoders/faults")
    words = rrb.Vertical(paths, rrb.Tabs(wheels_view(), faults, active_tab=0), row_shares=[5, 6])
    return rrb.Horizontal(words, series, column_shares=[5, 8], name="Encoders")


def wheels_view() -> rrb.TextDocumentView:
    """The diagnosis of the wheels."""
    return text_view("Diagnosis of the wheels", DIAGNOSIS)


def training(floors: Mapping[str, Floor], known: bool, *beside: rrb.View, began_s: float | None = None) -> Part:
    """How methods' maps of the training images unfold, over so much floor, their errors if known, and the losses."""
    start = None if began_s is None else rr.TimeRangeBoundary.absolute(seconds=began_s)
    shown = [("map of the training images", "training", "", ["floor_plan"] if known else [])]
    if known:
        shown.append(("errors on the training images", "training_error", "/**", ["floor_plan", "scale/**"]))
    rows: list[list[rrb.View]] = [
        [
            room_view(f"{title_of(name)}: {title}", [*around, f"{entity}/{name}{below}"], eye)
            for name, floor in floors.items()
            for eye in [aim_eye(floor, aspect=4.5 / len(floors))]
        ]
        for title, entity, below, around in shown
    ]
    title = "Loss, log10, first to last step: each pale, running median bright"
    losses = [series_view(title, f"training/{name}", start=start) for name in floors]
    rows.append([*losses, *beside])
    return rrb.Vertical(*(rrb.Horizontal(*row) for row in rows), name="Training")


def report() -> Part:
    """All figures, and the distribution of errors."""
    return rrb.Horizontal(text_view("Report", REPORT), distribution(), name="Report")


def distribution() -> rrb.Spatial2DView:
    """The distribution of errors."""
    return rrb.Spatial2DView(name="Distribution of errors", origin=DISTRIBUTION)
