"""The reports "rooms" and "corridors": errors in every room beside PoseNet's, and maps that are wrong."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture
from scipy.stats import binomtest

from deepgps.config.methods import title_of
from deepgps.evaluation.evaluate import FAR_M
from deepgps.reports.targets import Figure, mean_of, median_of, ratio_of, share_of, write
from deepgps.studies.reports.columns import (
    ACCEPTED,
    ERRORS,
    IN_CM,
    PAPERS_ERRORS,
    TRAIN,
    Column,
    Line,
    explain_accepted,
    form,
    in_unit,
    of_accepted,
    tabulate_lines,
)
from deepgps.studies.reports.compare import draw_dots
from deepgps.studies.table import LEVELS, Row, split_by, split_by_label

OURS = ("deepgps_compass", "deepgps")
"""Methods whose wins are counted, each over those that are not before it."""
NOTE = (
    "Errors on the test grid, for the worst heading of each position; aligned on training samples, never scaled. "
    "Seen: share of positions within 0.25 m of a training image. Flipped: share of neighbourhoods that the map flips."
)
SIGN_TEST = "p is from a two-sided sign test: above 0.05, these rooms do not show which of the two is more accurate."
SIGNS = {"fold_found": "folded", "turned": "turned", "undecided": "undecided"}
"""Columns that say that a map is wrong, and their words: the fold detector, parts turned by the compass, the map."""
NOISE, LOOK_ALIKE, SIZE = "encoder.step_noise", "room.look_alike", ("room.width_m", "room.depth_m")
FAR_SHARE = 0.1
"""A map is wrong if it misplaces more than this share of the training images."""
CORRIDORS_NOTE = (
    "Errors on the test grid, for the worst heading of each position; aligned on training samples, never scaled. Map: "
    "RMS of the initial map by compass, before training. Off: share of the training images that are placed more than "
    f"{FAR_M:g} m from the truth; a map with more than {100 * FAR_SHARE:.0f} % is wrong. Said: what the "
    "method says of its map without the truth, and the share of the way that it finds turned. Seen: share of "
    "positions within 0.25 m of a training image; where it is low, errors are the drive's. PoseNet and the nearest "
    "neighbour learn from true positions, so that noise of the encoders does not change them."
)


def _over_base(name: str, title: str) -> Column:
    return Column(
        f"{title} / PoseNet", lambda line: write(line.rows[0][name] / line.base[0][name] if line.base else None, "")
    )


def _say(line: Line) -> str:
    """What the method says of its map, in a word or two."""
    (row,) = line.rows
    if row["fold_found"] is None:
        return "-"
    share = {"turned": f" {write(row['turned'], '%')}"}
    return ", ".join(f"{word}{share.get(name, '')}" for name, word in SIGNS.items() if row[name]) or "nothing"


COLUMNS = (
    *IN_CM,
    *of_accepted(form),
    Column("RMS / side", form("relative_rms", ".2f", 100, " %")),
    Column("seen", in_unit("seen", "%")),
    Column("flipped", in_unit("flipped", "%")),
    TRAIN,
    _over_base("rms_m", "RMS"),
)
WORLD_COLUMNS = (
    *IN_CM[:2],
    _over_base("rms_m", "RMS"),
    _over_base("median_m", "median"),
    Column("map [cm]", lambda line: in_unit("map_rms_m", "cm")(line).removesuffix(" cm")),
    Column("off", in_unit("misplaced", "%")),
    Column("said", _say),
    Column("seen", in_unit("seen", "%")),
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table of all rooms and methods, their means and worst values; a note on it; and how often our methods win."""
    lines = [*_compare_rooms(rows, lambda row: (name_room(row, varied),))]
    for title, take in (("mean", np.mean), ("worst", np.max)):
        groups = split_by(rows, "method").items()
        lines += [Line((title, title_of(method)), group, take=take) for method, group in groups]
    return [tabulate_lines(["room", "method"], lines, COLUMNS), NOTE, *explain_accepted(rows), *_count_wins(rows)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """The errors of every method over all rooms; for ours also the ratio of mean RMS to PoseNet's over common rooms."""
    methods, baseline, figures = split_by(rows, "method"), find_baseline(rows), {}
    for method in [*(name for name in OURS[::-1] if name in methods), *(name for name in methods if name not in OURS)]:
        group, own = methods[method], method == "deepgps"
        prefix, title = ("", "") if own else (f"{method}_", f"{title_of(method)}, ")
        found = _measure_errors(group, title)
        both = [(row["rms_m"], baseline[row["recording"]]["rms_m"]) for row in group if row["recording"] in baseline]
        if both and method in OURS:
            mine, other = zip(*both, strict=True)
            found["posenet_ratio"] = ratio_of(f"{title}RMS / PoseNet's RMS", mine, other)
            found["wins"] = share_of(f"{title}rooms with RMS below PoseNet's", [one < two for one, two in both])
        if own:
            found["train_s"] = mean_of("training", [row["train_s"] for row in group], "s")
        figures |= {prefix + name: figure for name, figure in found.items()}
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every method in every room."""
    return _draw_rooms(split_by_label(rows, lambda row: name_room(row, varied)))


def report_corridors(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table of all worlds and methods, and one that counts wrong maps by method and noise."""
    lines = _compare_rooms(rows, lambda row: (_name_world(row, varied), _write_noise(row)))
    return [tabulate_lines(["world", "w", "method"], lines, WORLD_COLUMNS), CORRIDORS_NOTE, _count_wrong(rows)]


def measure_corridors(rows: Sequence[Row]) -> dict[str, Figure]:
    """Ratios of the compass to PoseNet without noise, wrong maps that nothing is said of, and how alike places look."""
    figures, baseline = {}, find_baseline(rows)
    ours = [row for row in rows if row["method"] == "deepgps_compass"]
    exact = [row for row in ours if not row.get(NOISE) and row["recording"] in baseline]
    for name, title in (("rms_m", "RMS"), ("median_m", "median")) if exact else ():
        ratios = [row[name] / baseline[row["recording"]][name] for row in exact]
        key = f"compass_{name.removesuffix('_m')}_ratio"
        figures[key] = median_of(f"{title} / PoseNet's, median over worlds", ratios, "")
    for key, method in (("compass_unsaid", "deepgps_compass"), ("deepgps_unsaid", "deepgps")):
        if some := [row for row in rows if row["method"] == method and has_map(row)]:
            unsaid = sum(is_wrong(row) and not is_flagged(row) for row in some)
            title = f"{title_of(method)}: maps wrong and not said to be, of {len(some)}"
            figures[key] = Figure(title, unsaid, "count")
    if nearest := [row["rms_m"] for row in rows if row["method"] == "knn"]:
        title = f"least RMS of the nearest neighbour, of {len(nearest)}"
        figures["aliased_rms_m"] = Figure(title, min(nearest), "cm", at_least=True)
    return figures


def draw_corridors(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every method in every world; a cross marks a wrong map."""
    worlds = split_by_label(rows, lambda row: _label_world(row, varied))
    picture = _draw_rooms(worlds)
    axes = picture.axes[0]
    for place, group in enumerate(worlds.values()):
        for row in filter(is_wrong, group):
            axes.plot(100 * row["rms_m"], place, "x", color="black", ms=9, zorder=4)
    axes.set_xlabel("error of the worst heading [cm]; crosses: wrong maps")
    return picture


def name_room(row: Row, varied: Sequence[str]) -> str:
    """A room by the settings that vary, such as ``bedroom l 31``."""
    return " ".join(str(row[name]) for name in varied)


def find_baseline(rows: Sequence[Row], method: str = "posenet") -> dict[str, Row]:
    """A method's rows by their recordings."""
    return {row["recording"]: row for row in rows if row["method"] == method}


def has_map(row: Row) -> bool:
    """Whether the method makes a map of its own, and the truth was asked about it."""
    return row["fold_found"] is not None and row["misplaced"] is not None


def is_wrong(row: Row) -> bool:
    """Whether the method's own map is wrong according to the truth."""
    return has_map(row) and row["misplaced"] > FAR_SHARE


def is_flagged(row: Row) -> bool:
    """Whether it is said, without the truth, that the map is folded, turned in parts, or not decided."""
    return bool(row["fold_found"] or row["turned"] or row["undecided"])


def _compare_rooms(rows: Sequence[Row], key) -> Iterator[Line]:
    baseline = find_baseline(rows)
    for row in rows:
        base = [baseline[row["recording"]]] if row["method"] != "posenet" and row["recording"] in baseline else []
        yield Line((*key(row), title_of(row["method"])), [row], base)


def _draw_rooms(rooms: Mapping[str, Sequence[Row]]) -> Picture:
    picture = draw_dots(rooms, (8, 1.4 + 0.4 * len(rooms)))
    picture.legend(frameon=False, fontsize=8, loc="outside upper center", ncols=4)
    return picture


def _measure_errors(group: Sequence[Row], title: str) -> dict[str, Figure]:
    figures = {
        name: mean_of(title + heading.removesuffix(" [cm]"), [row[name] for row in group], "cm")
        for name, heading in ERRORS.items()
    }
    accepted = {name: ACCEPTED[name].removesuffix(" [cm]") for name in ("rms_accepted_m", "max_accepted_m")}
    radii = {f"radius_{level}_holds": f"accepted images within their {level} % radius" for level in LEVELS}
    for name, words in {**accepted, **radii}.items():
        if values := [row[name] for row in group if row.get(name) is not None]:
            unit, at_least = ("%", True) if name in radii else ("cm", False)
            figures[name] = median_of(f"{title}{words}, median over rooms", values, unit, at_least)
    return figures


def _count_wins(rows: Sequence[Row]) -> list[str]:
    """A sentence for each of our methods and each baseline: in how many common rooms ours has the lower error."""
    baselines, sentences = split_by(rows, "method"), []
    for own in OURS:
        ours = find_baseline(baselines.pop(own, []), own)
        for method, group in baselines.items() if ours else ():
            pairs = [(ours[row["recording"]], row) for row in group if row["recording"] in ours]
            wins = [
                _count(word, [mine[name] - other[name] for mine, other in pairs])
                for name, word in PAPERS_ERRORS.items()
            ]
            sentences.append(
                f"Of {len(pairs)} rooms, {title_of(own)} has lower errors than {title_of(method)} in {', '.join(wins)}."
            )
    return [*sentences, SIGN_TEST] if sentences else []


def _count(word: str, differences: Sequence[float]) -> str:
    wins, losses = sum(value < 0 for value in differences), sum(value > 0 for value in differences)
    chance = binomtest(wins, wins + losses).pvalue if wins + losses else 1.0
    return f"{wins} by {word} (p = {chance:.2g})"


def _count_wrong(rows: Sequence[Row]) -> str:
    """A line for each method that makes its own map, and each noise: how many maps are wrong, said to be, or both."""
    lines = []
    for noise, same in split_by([{NOISE: None, **row} for row in rows if has_map(row)], NOISE).items():
        for method, group in split_by(same, "method").items():
            lines.append(Line(("-" if noise is None else f"{noise:g}", title_of(method)), group))
    columns = [
        Column("maps", lambda line: str(len(line.rows))),
        Column("wrong", lambda line: str(sum(map(is_wrong, line.rows)))),
        *(Column(f"said {word}", _count_sign(name)) for name, word in SIGNS.items()),
        Column("wrong, unsaid", lambda line: str(sum(is_wrong(row) and not is_flagged(row) for row in line.rows))),
        Column("right, said wrong", lambda line: str(sum(is_flagged(row) and not is_wrong(row) for row in line.rows))),
    ]
    return tabulate_lines(["w", "method"], lines, columns)


def _count_sign(name: str):
    """A writer of how many maps show a sign; a dash where the method does not look for it."""

    def write_count(line: Line) -> str:
        signs = [row[name] for row in line.rows]
        return "-" if all(sign is None for sign in signs) else str(sum(map(bool, signs)))

    return write_count


def _name_world(row: Row, varied: Sequence[str]) -> str:
    """A world in words, such as ``office 2, 10 x 7 m, alike``."""
    names = [name for name in varied if name not in (NOISE, LOOK_ALIKE, *SIZE)]
    sides = [f"{row[name]:g}" for name in SIZE if row.get(name)]
    size = [f"{' x '.join(sides)} m"] if sides else []
    return ", ".join([" ".join(str(row[name]) for name in names), *size, *(["alike"] if row.get(LOOK_ALIKE) else [])])


def _label_world(row: Row, varied: Sequence[str]) -> str:
    return f"{_name_world(row, varied)}, w {_write_noise(row)}" if row.get(NOISE) else _name_world(row, varied)


def _write_noise(row: Row) -> str:
    return "-" if row.get(NOISE) is None else f"{row[NOISE]:g}"
