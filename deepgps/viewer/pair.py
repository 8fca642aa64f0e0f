"""Two runs in one recording: each below ``a`` and ``b``, and the change of their error fields below ``a/change``.

A comparison reads runs that are complete, and adds nothing to them but its recording.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib import colormaps

from deepgps.config.methods import title_of
from deepgps.config.scenario import list_settings
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.reports.plots import SCALE_M
from deepgps.reports.run_figures import draw_error_cdf
from deepgps.reports.run_report import COLUMNS, read_metrics
from deepgps.reports.table import tabulate
from deepgps.runs.run_folder import open_run
from deepgps.viewer.error_field import find_thinness, log_field
from deepgps.viewer.layout import DISTRIBUTION, aim_eye, arrange, distribution, room_view, text_view
from deepgps.viewer.pictures import log_figure
from deepgps.viewer.run import hash_run
from deepgps.viewer.scene import LAYER_M, SCALE_COLOURS, lift, log_room, log_scale, log_strip
from deepgps.viewer.stream import put, put_text, save_recording
from sim.errors import InputError
from sim.geometry import FreeSpace, limits
from sim.recording.format import open_truth

PAIRS = "pairs"
MIN_DIFFERENCE_M = SCALE_M[0]  # Errors that differ by less than this count as equal [m]
LABELS = {0.0: "B better by 1 m", 0.25: "10 cm", 0.5: "within 1 cm", 0.75: "10 cm", 1.0: "B worse by 1 m"}
TABLES = (("rms_m", "median_m"), ("p95_m", "max_m"))  # Figures of each table, few enough for its width


@dataclass(frozen=True)
class Side:
    """One run of a pair."""

    folder: Path  # The run's folder
    metrics: Mapping[str, Any]  # The contents of its metrics.json
    fields: Mapping[str, ErrorField]  # Its error fields by method name
    space: FreeSpace  # The free space of its room
    scene: Path  # The file of its room


@dataclass(frozen=True)
class Pair:
    """Two runs, A and B."""

    sides: Mapping[str, Side]  # Both runs, by the entity below which each is logged
    methods: Sequence[str]  # Methods that both runs have, in the order of the first
    # Whether both have the same room and test positions, so that errors can be compared at each position
    same_floor: bool

    def errors(self, method: str) -> list[np.ndarray]:
        """Errors of A and of B at each test position (C,) [m], at the worst heading."""
        return [side.fields[method].worst for side in self.sides.values()]

    def change(self, method: str) -> np.ndarray:
        """Error of B minus error of A at each test position (C,) [m]."""
        a, b = self.errors(method)
        return b - a


def write_pair(folders: Sequence[Path]) -> Path:
    """Write the recording of two runs into ``pairs`` in the first one's folder; return its path.

    The runs' own files do not change. Raises InputError unless these are two complete runs with a method in common.
    """
    pair = open_pair(folders)
    shown = [(folder.resolve().name, open_run(folder).model_dump_json(), hash_run(folder)) for folder in folders]
    number = hashlib.sha256(str(shown).encode()).hexdigest()[:32]
    path = folders[0] / PAIRS / f"{number[:12]}.rrd"
    title = " and ".join(folder.resolve().name for folder in folders)
    save_recording(path, number, title, _make_blueprint(pair), lambda stream: _log_pair(stream, pair))
    return path


def open_pair(folders: Sequence[Path]) -> Pair:
    """Open two runs; raise InputError unless there are exactly two different runs with a method in common."""
    if len(folders) != 2:
        raise InputError(f"exactly two runs can be compared, not {len(folders)}: {', '.join(map(str, folders))}")
    if folders[0].resolve() == folders[1].resolve():
        raise InputError(f"{folders[0]} and {folders[1]} are the same run; choose two different ones")
    a, b = (
        Side(one, read_metrics(one), read_all_headings(one), open_truth(home).free_space, home / "scene.glb")
        for one, home in ((folder, folder / "recording") for folder in folders)
    )
    methods = [name for name in a.fields if name in b.fields]
    if not methods:
        has = ", ".join(f"{side.folder} has {', '.join(side.fields)}" for side in (a, b))
        raise InputError(f"no method is in both runs: {has}")
    places = (a.fields[methods[0]].truth, b.fields[methods[0]].truth)
    same = np.array_equal(*places) and np.array_equal(a.space.reachable, b.space.reachable)
    return Pair({"a": a, "b": b}, methods, same)


def colours_of_change(change: np.ndarray) -> np.ndarray:
    """Colours (..., 4) uint8 RGBA of changes (...,) [m]: grey up to a centimetre, then logarithmic to a metre, blue
    where B is better and red where it is worse."""
    decades = np.log10(SCALE_M[1] / MIN_DIFFERENCE_M)
    share = np.log10(np.maximum(np.abs(change), MIN_DIFFERENCE_M) / MIN_DIFFERENCE_M) / decades
    return (colormaps["coolwarm"](0.5 + 0.5 * np.sign(change) * share.clip(0.0, 1.0)) * 255).round().astype(np.uint8)


def describe_pair(pair: Pair) -> str:
    """Describe as Markdown both runs, the settings that differ, where which run is better, and both runs' figures."""
    runs = [
        [f"**{root.upper()}**", side.folder.resolve().name, str(side.metrics["scenario"]), str(side.metrics["seed"])]
        for root, side in pair.sides.items()
    ]
    blocks = [
        "# B compared with A",
        tabulate(["", "run", "scenario", "seed"], runs),
        _list_settings(pair),
        _list_places(pair),
        "Errors [cm] for the worst heading of each test position:",
        *(_list_figures(pair, names) for names in TABLES),
    ]
    return "\n\n".join(blocks)


def _list_settings(pair: Pair) -> str:
    """A table of the settings that differ, without ``methods``, since only common methods are shown."""
    a, b = (list_settings(open_run(side.folder)) for side in pair.sides.values())
    differ = [name for name in a | b if a.get(name) != b.get(name) and name != "methods"]
    rows = [[name, str(a.get(name, "-")), str(b.get(name, "-"))] for name in differ]  # of plugins, one may lack some
    return tabulate(["different setting", "A", "B"], rows) if rows else "Both runs have the same settings."


def _list_places(pair: Pair) -> str:
    if not pair.same_floor:
        return "**The rooms or test positions differ**, so there is no difference of the fields to show."
    rows = []
    for name in pair.methods:
        change = pair.change(name)
        better, worse = int((change < -MIN_DIFFERENCE_M).sum()), int((change > MIN_DIFFERENCE_M).sum())
        rows.append([title_of(name), str(better), str(len(change) - better - worse), str(worse)])
    table = tabulate(["method", "B better", "same", "B worse"], rows)
    return f"Test positions where B is better or worse by more than {100 * MIN_DIFFERENCE_M:g} cm:\n\n{table}"


def _list_figures(pair: Pair, names: Sequence[str]) -> str:
    columns = [column for column in COLUMNS if column[1] in names]
    heads = [name for heading, _, _ in columns for name in (f"{heading.split(' [')[0]} A", "B", "B / A")]
    rows = []
    for method in pair.methods:
        cells = [title_of(method)]
        for _, name, write in columns:
            a, b = (side.metrics["methods"].get(method, {}).get(name) for side in pair.sides.values())
            cells += ["-" if value is None else write(value) for value in (a, b)]
            cells.append("-" if not a or b is None else f"{b / a:.2f}")
        rows.append(cells)
    return tabulate(["method", *heads], rows)


def _log_pair(stream: rr.RecordingStream, pair: Pair) -> None:
    for root, side in pair.sides.items():
        log_room(stream, side.scene, side.space, root)
        log_scale(stream, f"{root}/scale", *limits(side.space))
        for name in pair.methods:
            log_field(stream, name, side.fields[name], root=root)
    if pair.same_floor:
        _log_changes(stream, pair)
    put_text(stream, "report/pair", describe_pair(pair))
    a, b = ({name: side.fields[name] for name in pair.methods} for side in pair.sides.values())
    log_figure(stream, DISTRIBUTION, draw_error_cdf(b, a))


def _log_changes(stream: rr.RecordingStream, pair: Pair) -> None:
    """Log a dot at each test position with both errors as text, and the scale of their colours."""
    half = np.geomspace(MIN_DIFFERENCE_M, SCALE_M[1], SCALE_COLOURS // 2 + 1)
    colours = colours_of_change(np.concatenate([-half[:0:-1], half]))
    log_strip(stream, "a/change_scale", *limits(pair.sides["a"].space), colours, LABELS)
    for name in pair.methods:
        truth, change = pair.sides["a"].fields[name].truth, pair.change(name)
        radius = 0.03 * find_thinness(truth)
        place = lift(truth, LAYER_M + radius)  # on the floor, not half below it
        dots = rr.Points3D(place, radii=radius, colors=colours_of_change(change), point_shading="Flat")
        rows = zip(100 * change, *(100 * error for error in pair.errors(name)), strict=True)
        words = {"change": [f"{one:+.1f} cm: A {before:.1f}, B {after:.1f}" for one, before, after in rows]}
        put(stream, f"a/change/{name}", dots, said=words)


def _make_blueprint(pair: Pair) -> rrb.Blueprint:
    """The viewer's layout for a pair: a tab for each method with both runs and, if they share a floor, the change."""

    def tab(name: str) -> rrb.Container:
        views = [
            room_view(
                f"{root.upper()}: error field of {title_of(name)}",
                ["room", "floor_plan", "scale/**", f"error_field/{name}/**"],
                aim_eye(limits(side.space), tilt=0.35),
                root,
            )
            for root, side in pair.sides.items()
        ]
        if pair.same_floor:
            shown = ["floor_plan", "change_scale/**", f"change/{name}"]
            views.append(room_view("Where the error changed from A to B", shown, aim_eye(limits(a.space)), "a"))
        return rrb.Grid(*views, text_view("Figures", "report/pair"), grid_columns=2, name=title_of(name))

    a = pair.sides["a"]
    return arrange([*map(tab, pair.methods), distribution()], rrb.TimePanel(state="hidden"))
