"""The viewer's layouts: of a finished run, of one in progress, of one without truth; and views that all layouts use."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.viewer.drive import DIAGNOSIS, POLAR_PICTURES
from deepgps.viewer.error_field import COVERAGE, DENSITY, ELLIPSE_SCALE, ELLIPSES, MAX_RADIUS_M, SIGMA
from deepgps.viewer.making import MAP_ENTITY, TEXT_ENTITY
from deepgps.viewer.pictures import DISTRIBUTION, LARGE_ENTITY
from deepgps.viewer.places import TRAINING_IMAGES
from deepgps.viewer.scene import BACKDROP, LAYER_M, STILL_BEHAVIOUR
from deepgps.viewer.stream import DEPLOYMENT, DRIVE_TIME, RUN_TIME, Span, show_until_now
from sim.geometry import FreeSpace, limits

HIDDEN_BEHAVIOUR = rrb.EntityBehavior(visible=False)
TICK_WINDOW_S, TRAIL_S = 60.0, 120.0
PLAYED_S = 100.0  # In which the viewer plays a drive
ASPECT = 1.6  # Width of most views over their height
PLACES = "Places"
PICTURE_TITLES = {
    "test": "Test image, white",
    "weight": "What differs, magenta",
    "answer_1": "At the answer 1, yellow",
    "answer_2": "At the answer 2, yellow",
    "closest": "Closest, green",
}
TICKS = ("Ticks per gap: left blue, right wide, green", "drive/ticks", TICK_WINDOW_S)
SEGMENT_ERROR = ("Encoder minus truth [mm]", "drive/segment_error", TICK_WINDOW_S)
WHEELS = ("Diagnosis of the wheels", DIAGNOSIS)
LOGARITHM = "0 is 1 cm, 1 is 10 cm, 2 is 1 m"  # What the values of a plot of errors mean
NIGHT = (13, 13, 13)  # Colour behind plans and rooms, in any theme
METRES = rrb.LineGrid3D(spacing=1.0, plane=rr.components.Plane3D.XY.with_distance(LAYER_M), color=(255, 255, 255, 25))
STEPS, FIGURES = "steps", "report/figures"
Layers = Mapping[str, Sequence[str]]  # Layers of a method's error field that are hidden at first, by method
Part = rrb.Container | rrb.View


def make_blueprint(
    space: FreeSpace,
    layers: Layers,
    trained: Sequence[str],
    pictures: Mapping[str, str],
    span: Span,
    mapped: str | None = None,
    sure: str | None = None,
    deployed: tuple[str, Mapping[str, str]] | None = None,
) -> rrb.Blueprint:
    """The viewer's layout for a finished run, which opens with what matters most, at the end of drive and training.

    It takes titles of the sensors' pictures by name; the methods, if any, whose initial map's making and whose radii
    by place are shown; and the one whose errors along the deployment drive are, with titles of its ways by name.
    """
    errors = rrb.Horizontal(series_view(*SEGMENT_ERROR), series_view(*TICKS))
    return arrange(
        [
            _error_fields(space, layers, ["place/test/**"]),
            _places(space, "polar" in pictures),
            *([_trust(space, sure)] if sure else []),
            *([_deployment(space, *deployed, "polar" in pictures)] if deployed else []),
            _drive(space, pictures, errors),
            *([_making(space, mapped)] if mapped else []),
            *([_training(space, trained, [_loss_view(name) for name in trained])] if trained else []),
            _encoders(space),
            rrb.Horizontal(text_view("Report", "report/text"), errors_view(), name="Report"),
        ],
        play(DRIVE_TIME, (span[1] - span[0]) / PLAYED_S),
    )


def make_live_blueprint(
    space: FreeSpace | None, pictures: bool, trained: Sequence[str], began_s: float, layers: Layers
) -> rrb.Blueprint:
    """The viewer's layout for a run in progress: a tab for each stage so far, with the newest in front.

    The room's floor is known once the recording is finished; the first training began at ``began_s`` [s].
    """
    steps = text_view("Steps", STEPS)
    tabs: list[Part] = [_drive(space, POLAR_PICTURES if pictures else {}, steps, RUN_TIME)]
    if space and trained:
        start = rr.TimeRangeBoundary.absolute(seconds=began_s)
        tabs.append(_training(space, trained, [*(_loss_view(name, start) for name in trained), steps]))
    if space and layers:
        tabs.append(_error_fields(space, layers))
    return arrange(tabs, play(RUN_TIME), len(tabs) - 1)


def make_blueprint_without_truth(
    pictures: Mapping[str, str], span: Span, reckoned: np.ndarray, last: Mapping[str, np.ndarray]
) -> rrb.Blueprint:
    """The viewer's layout for a run without truth: its dead-reckoned path (R, 2) and its methods' maps (n, 2) [m]."""
    path = rrb.Spatial3DView(
        background=NIGHT,
        name="Dead-reckoned path",
        origin="world",
        eye_controls=_aim_at(reckoned),
        overrides={"world/reckoned/path": rrb.VisibleTimeRanges(show_until_now())},
    )
    beside = rrb.Vertical(
        *_camera_views(pictures),
        series_view("Distance travelled [m]", "drive/distance"),
        series_view(*TICKS),
        rrb.Tabs(text_view("Without truth", "report"), text_view(*WHEELS)),
    )
    tabs: list[Part] = [rrb.Horizontal(path, beside, name="Drive", column_shares=[3, 2])]
    if last:
        eyes = {name: _aim_at(points, len(last)) for name, points in last.items()}
        maps = [
            rrb.Spatial3DView(name=title_of(name), origin=f"map/{name}", background=NIGHT, eye_controls=eye)
            for name, eye in eyes.items()
        ]
        losses = [_loss_view(name) for name in last]
        tabs.append(rrb.Vertical(rrb.Horizontal(*maps), rrb.Horizontal(*losses), name="Training", row_shares=[3, 1]))
    return arrange(tabs, play(DRIVE_TIME, (span[1] - span[0]) / PLAYED_S))


def arrange(tabs: Sequence[Part], time: rrb.TimePanel, active: int = 0) -> rrb.Blueprint:
    """A layout of tabs between panels that are closed, since the tooltip says what the selection panel would."""
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=active),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
    )


def play(timeline: str, speed: float = 1.0) -> rrb.TimePanel:
    """A closed time panel, whose slider stands at the end of a timeline."""
    return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following", playback_speed=speed)


def room_view(
    name: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D,
    root: str = "world",
    overrides: Mapping[Any, Any] | None = None,
    line_grid: bool = False,
) -> rrb.Spatial3DView:
    """A dark view of entities below ``root``; only what can tell something catches the pointer; a plan has lines
    every metre."""
    return rrb.Spatial3DView(
        name=name,
        origin=root,
        contents=[f"{root}/{one}" for one in contents],
        eye_controls=eye,
        line_grid=line_grid or ("room" not in contents and METRES),
        background=NIGHT,
        overrides={f"{root}/{name}": STILL_BEHAVIOUR for name in BACKDROP} | dict(overrides or {}),
    )


def errors_view() -> rrb.Spatial2DView:
    """A view of the distribution of errors."""
    return rrb.Spatial2DView(name="Distribution of errors", origin=DISTRIBUTION)


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
    space: FreeSpace | None, tilt: float = 0.0, reach: float = 1.0, before: float = 0.25, aspect: float = ASPECT
) -> rrb.EyeControls3D:
    """Place the eye above a room, or above one of usual size, with space for the scale in front of it.

    It is tilted to the south [rad], ``reach`` times as far away as the plan needs, and looks south of the middle [m].
    The aspect is the view's width over its height.
    """
    if space is None:
        return look((0.0, -3.0, 6.4), (0.0, -0.3, 0.0))
    return _aim_at_rectangle(*limits(space), tilt, reach, before, min(aspect, ASPECT))


def look(position: Any, target: Any) -> rrb.EyeControls3D:
    """An eye at a position (3,) [m] with north up, since one exactly above has no up direction of its own."""
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=(0.0, 1.0, 0.0))


def _aim_at_rectangle(
    low: np.ndarray,
    high: np.ndarray,
    tilt: float = 0.0,
    reach: float = 1.0,
    before: float = 0.0,
    aspect: float = ASPECT,
) -> rrb.EyeControls3D:
    middle = np.array([*(low + high) / 2, 0.0]) - [0, before, 0]
    distance = reach * (1.2 * max(high[1] - low[1], (high[0] - low[0]) / aspect) + (0.8 if before else 0.1))
    return look(middle + distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)]), middle)


def _aim_at(points: np.ndarray, views: int = 1) -> rrb.EyeControls3D:
    """Place the eye above points (n, 2) [m] in one of several views side by side."""
    return _aim_at_rectangle(points.min(axis=0), points.max(axis=0), reach=max(1.2, 0.55 * views))


def _camera_views(pictures: Mapping[str, str]) -> list[Part]:
    """Views of the sensors' pictures by their titles: those drawn for people above the others."""
    views = {name: rrb.Spatial2DView(name=title, origin=f"drive/{name}") for name, title in pictures.items()}
    large = [views.pop(LARGE_ENTITY)] if LARGE_ENTITY in views else []
    shares = [1 if name == "fisheye" else 2 for name in views]
    return [*large, *([rrb.Horizontal(*views.values(), column_shares=shares)] if views else [])]


def _loss_view(name: str, start: Any = None) -> rrb.TimeSeriesView:
    return series_view(
        "Loss, log10, first to last step: each pale, running median bright", f"training/{name}", start=start
    )


def _error_fields(space: FreeSpace, layers: Layers, places: Sequence[str] = ()) -> Part:
    """The first method's error field in the furnished room, all figures, and the other methods' fields as plans."""
    first, *others = layers
    coverage = [path.removeprefix("world/") for path in (COVERAGE, DENSITY)]
    around = ["floor_plan", "scale/**", *places, *coverage]
    wide = len(others) > 1  # plans below leave less height

    def field_view(name: str, method: str, eye: rrb.EyeControls3D, around: Sequence[str]) -> rrb.Spatial3DView:
        hidden = dict.fromkeys([*layers[method], COVERAGE, DENSITY], HIDDEN_BEHAVIOUR)
        return room_view(name, [*around, f"error_field/{method}/**"], eye, overrides=hidden)

    room = rrb.Tabs(
        field_view(
            f"Error field of {title_of(first)}", first, aim_eye(space, tilt=0.45, reach=1.08), ["room", *around]
        ),
        field_view("From above", first, aim_eye(space, reach=0.85 if wide else 1.0), around),
        active_tab=0,
    )
    eye = aim_eye(space, reach=0.85, before=0.0, aspect=4.8 / max(len(others), 1) if wide else ASPECT)
    plans = [field_view(title_of(name), name, eye, ["floor_plan", *coverage]) for name in others]
    figures = text_view("Figures", FIGURES)
    if not wide:
        return rrb.Horizontal(room, rrb.Vertical(figures, *plans), column_shares=[5, 2], name="Error field")
    above_all = rrb.Horizontal(room, figures, column_shares=[5, 2])
    return rrb.Vertical(above_all, rrb.Horizontal(*plans), row_shares=[5, 3], name="Error field")


def _places(space: FreeSpace, pictures: bool) -> Part:
    """One image at a time, beside training images, its place and its modes on the floor plan, and its numbers."""
    shown = ["radius", "error", "test", "near", "modes/**", *(f"{name}/**" for name in TRAINING_IMAGES)]  # no label
    floor = room_view(
        "The place, and others that explain the image",
        ["floor_plan", "outline", *(f"place/{one}" for one in shown)],
        aim_eye(space, reach=0.9, before=0.0),
    )
    texts = [text_view("Place", "place/text"), text_view("Training images", "place/taken")]
    if not pictures:
        return rrb.Horizontal(floor, rrb.Vertical(*texts, row_shares=[3, 2]), column_shares=[5, 3], name=PLACES)
    rows = [
        rrb.Horizontal(*(rrb.Spatial2DView(name=name, origin=f"place/{one}/{kind}") for one, name in titles.items()))
        for kind, titles in (("round", PICTURE_TITLES), ("polar", dict.fromkeys(PICTURE_TITLES, "Polar")))
    ]
    below = rrb.Horizontal(floor, *texts, column_shares=[6, 5, 4])
    return rrb.Vertical(*rows, below, row_shares=[9, 3, 11], name=PLACES)


def _trust(space: FreeSpace, method: str) -> Part:
    """The radius that a method expects at each place, with ellipses."""
    title = (
        f"{title_of(method)}: radius of 68 % (grey: refused), and ellipses of 95 % up to {100 * MAX_RADIUS_M:g} cm, "
        f"{ELLIPSE_SCALE} times as large"
    )
    layers = [f"error_field/{method}/{layer}" for layer in (SIGMA, ELLIPSES)]
    sigma = room_view(title, ["floor_plan", "outline", "radius_scale/**", *layers], aim_eye(space))
    return rrb.Horizontal(sigma, name="Trust")


def _deployment(space: FreeSpace, method: str, ways: Mapping[str, str], pictures: bool) -> Part:
    """The deployment drive in the colours of a method's errors along it, for each way of finding positions."""
    eye, around = aim_eye(space, reach=0.9, aspect=2.9 / len(ways)), ["floor_plan", "outline", "scale/**"]
    views = [
        room_view(f"{title_of(method)}: {title}", [*around, f"{DEPLOYMENT}/{name}/**"], eye)
        for name, title in ways.items()
    ]
    below: list[Part] = [series_view(f"Errors along the drive: {LOGARITHM}", f"{DEPLOYMENT}/error", legend=True)]
    if pictures:
        below += [rrb.Spatial2DView(name=title, origin=f"{DEPLOYMENT}/{one}") for one, title in POLAR_PICTURES.items()]
    return rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*below), row_shares=[5, 3], name="Deployment")


def _drive(space: FreeSpace | None, pictures: Mapping[str, str], below: Part, timeline: str = DRIVE_TIME) -> Part:
    room = room_view(
        "Robot and path so far",
        ["room", "drive/**"],
        aim_eye(space, tilt=0.45, reach=1.3, before=-0.4),
        overrides={"world/drive/path": rrb.VisibleTimeRanges(show_until_now(timeline))},
        line_grid=space is None,
    )
    shares = [*([3] if LARGE_ENTITY in pictures else []), *([2] if set(pictures) - {LARGE_ENTITY} else []), 2]
    beside = rrb.Vertical(*_camera_views(pictures), below, row_shares=shares)
    return rrb.Horizontal(room, beside, column_shares=[5, 4], name="Drive")


def _making(space: FreeSpace, method: str) -> Part:
    title = "The initial map in the making: choose the timeline `making`"
    making = room_view(
        title, ["outline", f"{MAP_ENTITY.removeprefix('world/')}/**"], aim_eye(space, before=0.0, aspect=1.05)
    )
    field = ["floor_plan", "scale/**", f"error_field/{method}/worst/**"]
    beside = rrb.Vertical(
        text_view("This stage", TEXT_ENTITY), room_view(f"Error field of {title_of(method)}", field, aim_eye(space))
    )
    return rrb.Horizontal(making, beside, column_shares=[5, 3], name="Initial map")


def _encoders(space: FreeSpace) -> Part:
    """The encoders' errors: in words, as paths on the floor, along the drive, and for each segment."""
    trail = rrb.VisibleTimeRanges(show_until_now(seconds=TRAIL_S))
    paths = room_view(
        "True path (blue) and dead-reckoned path (orange)",
        ["floor_plan", "drive/**", "reckoned/**"],
        aim_eye(space, reach=1.5, before=0.0),
        overrides={"world/drive/path": trail, "world/reckoned/path": trail},
    )
    faults = text_view("Faults that were set", "encoders/faults")
    difference = series_view("Ticks per gap, right minus left", "drive/tick_difference", TICK_WINDOW_S)
    series = rrb.Vertical(
        rrb.Horizontal(series_view(*SEGMENT_ERROR), series_view(*TICKS), difference),
        series_view("Dead-reckoning drift [m]", "encoders/drift"),
        rrb.Spatial2DView(name="Each segment", origin="encoders/segments"),
        row_shares=[4, 4, 6],
    )
    words = rrb.Vertical(paths, rrb.Tabs(text_view(*WHEELS), faults, active_tab=0), row_shares=[5, 6])
    return rrb.Horizontal(words, series, column_shares=[5, 8], name="Encoders")


def _training(space: FreeSpace, trained: Sequence[str], losses: Sequence[rrb.View]) -> Part:
    aspect = 4.5 / len(trained)
    above, front = aim_eye(space, reach=0.85, before=0.0, aspect=aspect), aim_eye(space, aspect=aspect)
    rows = [
        [room_view(f"{title_of(name)}: {title}", [*around, f"{shown}/{name}{below}"], eye) for name in trained]
        for title, around, shown, below, eye in (
            ("map of the training images", ["outline"], "training", "", above),
            ("errors on the training images", ["outline", "scale/**"], "training_error", "/**", front),
        )
    ]
    parts = [rrb.Horizontal(*row) for row in (*rows, losses)]
    return rrb.Vertical(*parts, row_shares=[5, 6, 4], name="Training")
