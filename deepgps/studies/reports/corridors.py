"""The report of worlds whose places look alike: errors beside PoseNet's, and wrong maps that nothing is said of."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import title_of
from deepgps.evaluation.evaluate import FAR_M
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, median_of, write
from deepgps.studies.reports.rooms import draw_errors
from deepgps.studies.table import Row, find_methods, split_by

SIGNS = {"fold_found": "folded", "turned": "turned", "undecided": "undecided"}
"""Columns that say that a map is wrong, and their words: the fold detector, parts turned by the compass, the map."""
NOISE, LOOK_ALIKE, SIZE = "encoder.step_noise", "room.look_alike", ("room.width_m", "room.depth_m")
FAR_SHARE = 0.1
"""A map is wrong if it misplaces more than this share of the training images."""
NOTE = (
    "Errors on the test grid, for the worst heading of each position; aligned on training samples, never scaled. Map: "
    "RMS of the initial map by compass, before training. Off: share of the training images that are placed more than "
    f"{FAR_M:g} m from the truth; a map with more than {100 * FAR_SHARE:.0f} % is wrong. Said: what the "
    "method says of its map without the truth, and the share of the way that it finds turned. Seen: share of "
    "positions within 0.25 m of a training image; where it is low, errors are the drive's. PoseNet and the nearest "
    "neighbour learn from true positions, so that noise of the encoders does not change them."
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table of all worlds and methods, and one that counts wrong maps by method and noise."""
    headings = [
        "world",
        "w",
        "method",
        "RMS [cm]",
        "median [cm]",
        "RMS / PoseNet",
        "median / PoseNet",
        "map [cm]",
        "off",
        "said",
        "seen",
    ]
    baselines, cells = _find(rows, "posenet"), []
    for row in rows:
        baseline = baselines.get(row["recording"]) if row["method"] != "posenet" else None
        ratios = [write(row[name] / baseline[name] if baseline else None, "") for name in ("rms_m", "median_m")]
        errors = [f"{100 * row[name]:.1f}" for name in ("rms_m", "median_m")]
        extra = [write(row.get("map_rms_m"), "cm").removesuffix(" cm"), write(row["misplaced"], "%"), _said(row)]
        extra.append(write(row["seen"], "%"))
        cells.append([_world(row, varied), _noise(row), title_of(row["method"]), *errors, *ratios, *extra])
    return [tabulate(headings, cells), NOTE, _count(rows)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Ratios of the compass to PoseNet without noise, wrong maps that nothing is said of, and how alike places look."""
    figures, baselines = {}, _find(rows, "posenet")
    ours = [row for row in rows if row["method"] == "deepgps_compass"]
    exact = [row for row in ours if not row.get(NOISE) and row["recording"] in baselines]
    for name, title in (("rms_m", "RMS"), ("median_m", "median")) if exact else ():
        mine, other = np.array([(row[name], baselines[row["recording"]][name]) for row in exact]).T
        key = f"compass_{name.removesuffix('_m')}_ratio"
        figures[key] = median_of(f"{title} / PoseNet's, median over worlds", (mine / other).tolist(), "")
    for key, method in (("compass_unsaid", "deepgps_compass"), ("deepgps_unsaid", "deepgps")):
        some = [row for row in rows if row["method"] == method and has_map(row)]
        if some:
            unsaid = sum(is_wrong(row) and not is_flagged(row) for row in some)
            figures[key] = Figure(f"{title_of(method)}: maps wrong and not said to be, of {len(some)}", unsaid, "count")
    if nearest := [row["rms_m"] for row in rows if row["method"] == "knn"]:
        figures["aliased_rms_m"] = Figure(
            f"least RMS of the nearest neighbour, of {len(nearest)}", min(nearest), "cm", at_least=True
        )
    return figures


def has_map(row: Row) -> bool:
    """Whether the method makes a map of its own, and the truth was asked about it; earlier versions did not."""
    return row["fold_found"] is not None and row["misplaced"] is not None


def is_wrong(row: Row) -> bool:
    """Whether the method's own map is wrong according to the truth."""
    return has_map(row) and row["misplaced"] > FAR_SHARE


def is_flagged(row: Row) -> bool:
    """Whether it is said, without the truth, that the map is folded, turned in parts, or not decided."""
    return bool(row["fold_found"] or row["turned"] or row["undecided"])


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every method in every world; a cross marks a wrong map."""
    picture = draw_errors(rows, lambda row: _label(row, varied))
    axes, worlds = picture.axes[0], list(dict.fromkeys(_label(row, varied) for row in rows))
    for row in filter(is_wrong, rows):
        axes.plot(100 * row["rms_m"], worlds.index(_label(row, varied)), "x", color="black", ms=9, zorder=4)
    axes.set_xlabel("error of the worst heading [cm]; crosses: wrong maps")
    return picture


def _count(rows: Sequence[Row]) -> str:
    """A line for each method that makes its own map, and each noise: how many maps are wrong, said to be, or both."""
    said = (f"said {word}" for word in SIGNS.values())
    headings = ["w", "method", "maps", "wrong", *said, "wrong, unsaid", "right, said wrong"]
    cells = []
    for noise, same in split_by([{NOISE: None, **row} for row in rows], NOISE).items():
        for method in find_methods(filter(has_map, same)):
            group = [row for row in same if row["method"] == method and has_map(row)]
            wrong, flagged = ([test(row) for row in group] for test in (is_wrong, is_flagged))
            unsaid = sum(one and not other for one, other in zip(wrong, flagged, strict=True))
            alarms = sum(other and not one for one, other in zip(wrong, flagged, strict=True))
            signs = [_count_sign([row[name] for row in group]) for name in SIGNS]
            counts = [str(len(group)), str(sum(wrong)), *signs, str(unsaid), str(alarms)]
            cells.append(["-" if noise is None else f"{noise:g}", title_of(method), *counts])
    return tabulate(headings, cells)


def _count_sign(signs: Sequence[bool | float | None]) -> str:
    """In how many maps a sign shows; a dash where the method does not look for it."""
    return "-" if all(sign is None for sign in signs) else str(sum(bool(sign) for sign in signs))


def _find(rows: Sequence[Row], method: str) -> Mapping[str, Row]:
    return {row["recording"]: row for row in rows if row["method"] == method}


def _world(row: Row, varied: Sequence[str]) -> str:
    """A world in words, such as ``office 2, 10 x 7 m, alike``."""
    names = [name for name in varied if name not in (NOISE, LOOK_ALIKE, *SIZE)]
    sides = [f"{row[name]:g}" for name in SIZE if row.get(name)]
    size = [f"{' x '.join(sides)} m"] if sides else []
    return ", ".join([" ".join(str(row[name]) for name in names), *size, *(["alike"] if row.get(LOOK_ALIKE) else [])])


def _label(row: Row, varied: Sequence[str]) -> str:
    return f"{_world(row, varied)}, w {_noise(row)}" if row.get(NOISE) else _world(row, varied)


def _noise(row: Row) -> str:
    return "-" if row.get(NOISE) is None else f"{row[NOISE]:g}"


def _said(row: Row) -> str:
    """What the method says of its map, in a word or two."""
    if row["fold_found"] is None:
        return "-"
    share = {"turned": f" {write(row['turned'], '%')}"}
    return ", ".join(f"{word}{share.get(name, '')}" for name, word in SIGNS.items() if row[name]) or "nothing"
