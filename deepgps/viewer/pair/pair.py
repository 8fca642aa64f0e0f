"""Two runs in one recording: the change of their error fields below ``change``, each run below ``a`` and ``b``."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.runs.run_folder import open_run
from deepgps.viewer.distribution import distribution_view, log_distribution
from deepgps.viewer.error_field import find_thinness, log_field
from deepgps.viewer.pair.difference import (
    Pair,
    Side,
    colours_of_change,
    describe_pair,
    measure_change,
    open_pair,
    scale_change,
)
from deepgps.viewer.run.recording import hash_run
from deepgps.viewer.save import find_home, holds, save_recording
from deepgps.viewer.scene import LAYER_M, STRIP, lift, log_room, log_scale, log_strip
from deepgps.viewer.views import aim_eye, arrange, field_view, hold_still
from sim.occupancy import FreeSpace, limits

PAIRS = "pairs"
LABELS = {-1.0: "B better by 1 m", -0.5: "10 cm", 0.0: "within 1 cm", 0.5: "10 cm", 1.0: "B worse by 1 m"}


def write_pair(folders: Sequence[Path]) -> Path:
    """Write the recording of two runs into ``pairs`` in the first one's folder unless it exists; return its path.

    The runs' own files do not change, and nothing is added to a first run of an earlier version: its pairs are in the
    user's cache.

    Raises:
        InputError: The folders are not two complete runs with a method in common.
    """
    pair = open_pair(folders)
    number = _hash_pair(folders)
    path = find_home(folders[0]) / PAIRS / f"{number[:12]}.rrd"
    if not holds(path, number):
        title = " and ".join(folder.resolve().name for folder in folders)
        save_recording(path, number, title, make_pair_blueprint(pair), lambda stream: _log_pair(stream, pair))
    return path


def make_pair_blueprint(pair: Pair) -> rrb.Blueprint:
    """The viewer's layout for a pair: the difference, if both runs share a floor, then both runs side by side."""
    tabs = [*([_change(pair)] if pair.same_floor else []), _sides(pair), distribution_view()]
    return arrange(tabs, rrb.TimePanel(state="hidden"))


def _hash_pair(folders: Sequence[Path]) -> str:
    """Thirty-two hexadecimal digits of everything that the recording of two runs shows."""
    shown = [(folder.resolve().name, open_run(folder).model_dump_json(), hash_run(folder)) for folder in folders]
    return hashlib.sha256(str(shown).encode()).hexdigest()[:32]


def _log_pair(stream: rr.RecordingStream, pair: Pair) -> None:
    for root, side in (("a", pair.a), ("b", pair.b)):
        _log_side(stream, root, side, pair.methods)
    if pair.same_floor:
        log_room(stream, pair.a.folder / "recording" / "scene.glb", pair.a.space, "change")
        _log_change_scale(stream, pair.a.space)
        for name in pair.methods:
            _log_change(stream, name, pair)
    stream.log("report/pair", rr.TextDocument(describe_pair(pair), media_type="text/markdown"), static=True)
    errors = {name: [side.fields[name].worst for side in (pair.a, pair.b)] for name in pair.methods}
    log_distribution(stream, errors, ("A", "B"))


def _log_side(stream: rr.RecordingStream, root: str, side: Side, methods: Sequence[str]) -> None:
    log_room(stream, side.folder / "recording" / "scene.glb", side.space, root)
    log_scale(stream, side.space, root)
    for name in methods:
        log_field(stream, name, side.fields[name], root=root)


def _log_change(stream: rr.RecordingStream, name: str, pair: Pair) -> None:
    """Log a dot at each test position with both errors as text, and the changes themselves as values."""
    a, b, change = pair.a.fields[name], pair.b.fields[name], measure_change(pair, name)
    radius = 0.03 * find_thinness(a.truth)
    dots = rr.Points3D(
        lift(a.truth, LAYER_M + radius),  # on the floor, not half below it
        radii=radius,
        colors=colours_of_change(scale_change(change)),
        point_shading="Flat",
    )
    rows = zip(100 * change, 100 * a.worst, 100 * b.worst, strict=True)
    said = [f"{one:+.1f} cm: A {before:.1f}, B {after:.1f}" for one, before, after in rows]
    stream.log(f"change/field/{name}/places", dots, rr.AnyValues(change=said), static=True)
    stream.log(f"change/field/{name}", rr.AnyValues(change_m=change), static=True)


def _log_change_scale(stream: rr.RecordingStream, space: FreeSpace) -> None:
    colours = colours_of_change(np.linspace(-1, 1, STRIP))
    labels = {(change + 1) / 2: label for change, label in LABELS.items()}
    log_strip(stream, "change/scale", *limits(space), colours, labels)


def _change(pair: Pair) -> rrb.Horizontal:
    first, *others = pair.methods
    room = rrb.Spatial3DView(
        name=f"Where the error of {title_of(first)} changed from A to B",
        origin="change",
        contents=["change/room", "change/floor_plan", "change/scale/**", f"change/field/{first}/**"],
        eye_controls=aim_eye(pair.a.space, tilt=0.45, reach=1.08),
        line_grid=False,
        overrides=hold_still("change"),
    )
    plans = [
        rrb.Spatial3DView(
            name=f"{title_of(name)}: A to B",
            origin="change",
            contents=["change/floor_plan", f"change/field/{name}/**"],
            eye_controls=aim_eye(pair.a.space, reach=0.85, before=0.0),
            line_grid=False,
            overrides=hold_still("change"),
        )
        for name in others
    ]
    fields = rrb.Vertical(room, *([rrb.Horizontal(*plans)] if plans else []), row_shares=[5, 2] if plans else [1])
    return rrb.Horizontal(fields, _text(), column_shares=[5, 2], name="Difference")


def _sides(pair: Pair) -> rrb.Horizontal:
    fields = [
        rrb.Vertical(
            *(
                field_view(
                    f"{letter}: error field of {title_of(name)}",
                    name,
                    aim_eye(side.space, tilt=0.35, reach=1.0),
                    ["room", "floor_plan", "scale/**"],
                    root=root,
                )
                for letter, root, side in (("A", "a", pair.a), ("B", "b", pair.b))
            ),
            name=title_of(name),
        )
        for name in pair.methods
    ]
    return rrb.Horizontal(rrb.Tabs(*fields), _text(), column_shares=[5, 2], name="Side by side")


def _text() -> rrb.TextDocumentView:
    return rrb.TextDocumentView(name="Figures", origin="report/pair")
