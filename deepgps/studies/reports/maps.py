"""The reports "seeds", "maps", "corridors", "concave", "mds": maps that are folded, wrong, or hard to make."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from deepgps.evaluation.error_field import find_rms
from deepgps.studies.reports.compare import COMPARE
from deepgps.studies.reports.compare import NOTE as COMPARE_NOTE
from deepgps.studies.reports.paper import OUR_METHODS, compare_with_posenet
from deepgps.studies.reports.record import (
    CHOICES,
    ERRORS,
    GRID,
    VARIED_SETTINGS,
    Curves,
    Dots,
    Scatter,
    StudyReport,
    Table,
    Target,
)
from deepgps.studies.reports.render import FLIP_LIMIT
from deepgps.studies.table import Row, choices, describe, is_seed, split_by

MIRRORED_M2 = 0.1
"""A map is mirrored in part if the largest connected patch that it turns over has more than this area [m^2]."""
NOISE, SLIP = "encoder.step_noise", "encoder.slip_per_m"
SEEDS_NOTE = (
    f"A map is folded if it flips more than {100 * FLIP_LIMIT:.0f} % of the test grid's neighbourhoods; said: how many "
    "maps the detector reports as folded. Errors are medians over the maps."
)
MAPS_NOTE = (
    "RMS errors of the initial map at the training images, after a rigid alignment, and the error that the map's own "
    "covariance expects. NEES / 2: squared error over that covariance; 1 if the covariance is right, larger if the map "
    f"is too sure. Mirrored: maps with a connected patch of more than {MIRRORED_M2:g} m2 of reversed neighbourhoods. "
    "Methods without a map by compass are left out."
)
SIGNS = {"fold_found": "folded", "turned": "turned", "undecided": "undecided"}
"""Columns that say that a map is wrong, and their words: the fold detector, parts turned by the compass, the map."""
FAR_SHARE = 0.1  # A map is wrong if it misplaces more than this share of the training images
CORRIDORS_NOTE = (
    f"{GRID}Map: RMS of the initial map by compass, before training. Off: share of the training images that are placed "
    f"more than 0.5 m from the truth; a map with more than {100 * FAR_SHARE:.0f} % is wrong. Said: what the "
    "method says of its map without the truth, and the share of the way that it finds turned. Seen: share of "
    "positions within 0.25 m of a training image; where it is low, errors are the drive's. PoseNet and the nearest "
    "neighbour learn from true positions, so that noise of the encoders does not change them. Base: PoseNet."
)
SHAPE = "room.shape"
EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0)
"""Edges of the bins of reach, as shares of the floor, into which positions are sorted."""
SMALL_REACH_BINS, BINS = 2, len(EDGES) - 1  # Leading bins that reach little of the room, and all bins
CONCAVE_NOTE = (
    "Reach: share of the accessible floor that the robot can reach from a position by one straight drive. Positions "
    "of all rooms are pooled; errors are for the worst heading. PoseNet learns from true positions, so errors that "
    "both methods make are not due to a lack of straight paths."
)
MDS_NOTE = (
    "At one heading, aligned on the grid itself. Own: the network's positions; MDS: the map by classical scaling of "
    "its distances; apart: RMS distance between the two. Planar: share of the two largest eigenvalues in the sum of "
    "the absolute values of all. Joined: median error of the distance between positions that the robot can join by a "
    "straight drive; not joined: the same for positions that it cannot. Folded: maps that flip more than a tenth of "
    "the neighbourhoods."
)


def name_starts(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows of methods whose maps can fold, with how they start."""
    names = choices(rows, [name for name in varied if not is_seed(name)])
    ours = [row for row in rows if row["fold_found"] is not None]
    unfolded = {None: None, True: False, False: True}
    return [{**row, "start": describe(row, names), "unfolded": unfolded[row["folded"]]} for row in ours]


def name_encoders(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with an initial map, with the encoders' errors in words, and whether a part of the map is turned over."""

    def name(row: Row) -> str:
        faults = {"w": row.get(NOISE), "slip": row.get(SLIP)}
        return ", ".join(f"{word} {value:g}" for word, value in faults.items() if value) or "exact"

    ours = [row for row in rows if row["map_rms_m"] is not None]
    return [{**row, "encoder": name(row), "mirrored": row["map_flipped_m2"] > MIRRORED_M2} for row in ours]


def judge_maps(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """The same, with whether a method's own map is wrong, what is said of it without the truth, and what is not."""
    prepared = []
    usual = {"turned": None, "undecided": None, NOISE: None}
    for row in compare_with_posenet([{**usual, **row} for row in rows], varied):
        judged: Row = {"maps": None, "wrong": None, "wrong_unsaid": None, "right_said_wrong": None, "said": None}
        judged |= {f"said_{word}": None if row[name] is None else bool(row[name]) for name, word in SIGNS.items()}
        if row["fold_found"] is not None and row.get("misplaced") is not None:
            wrong, words = row["misplaced"] > FAR_SHARE, [word for name, word in SIGNS.items() if row[name]]
            judged |= {"maps": True, "wrong": wrong, "said": ", ".join(words) or "nothing"}
            judged |= {"wrong_unsaid": wrong and not words, "right_said_wrong": bool(words) and not wrong}
        known = [name for name in ("rms_m", "median_m") if row["base_rms_m"]]
        prepared.append({**row, **judged, **{f"{name}_ratio": row[name] / row[f"base_{name}"] for name in known}})
    return prepared


def pool_by_reach(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows, one more for each method and bin of reach, with the errors of all its positions, and one with ratios."""
    prepared = [{**row, "kind": "run"} for row in rows]
    for method, group in split_by(rows, "method").items():
        for part, (low, high) in enumerate(pairwise(EDGES)):
            if len(errors := pool(group, [part])):
                figures = {"rms_m": find_rms(errors), "median_m": float(np.median(errors)), "positions": len(errors)}
                reach = f"{100 * low:.0f}-{100 * high:.0f} %"
                where = {"kind": "reach", "reach": reach, "axis": 50 * (low + high), "method": method}
                prepared.append({**where, **figures})
        little, rest = pool(group, range(SMALL_REACH_BINS)), pool(group, range(SMALL_REACH_BINS, BINS))
        shapes = {shape: find_rms(pool(some)) for shape, some in split_by(group, SHAPE).items()}
        both = {"two_rooms", "rectangle"} <= set(shapes)
        ratios = {
            "little": find_rms(little) / find_rms(rest) if len(little) and len(rest) else None,
            "two_rooms": shapes["two_rooms"] / shapes["rectangle"] if both else None,
        }
        prepared.append({"kind": "ratio", "method": method, **ratios})
    return prepared


def pool(rows: Sequence[Row], parts: Sequence[int] = range(BINS)) -> np.ndarray:
    """Errors (n,) [m] of all positions of these rows in these bins of reach."""
    return np.concatenate([np.asarray(row[f"errors_{part}_m"], float) for row in rows for part in parts])


def divide_joined(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with how much larger the errors of distances are where no straight drive joins two positions."""
    known = [row["joined_m"] and row["unjoined_m"] is not None for row in rows]
    return [
        {**row, "not_joined_ratio": row["unjoined_m"] / row["joined_m"] if is_known else None}
        for row, is_known in zip(rows, known, strict=True)
    ]


def _list_targets_of_seeds() -> list[Target]:
    own, words = {"learn.start": lambda start: start != "random"}, "unfolded, of {count} maps without random starts"
    return [
        Target("unfolded", words, "unfolded:share", own, at_least=True),
        Target("found", "folds found, of {count}", "fold_found:share", {"folded": True}, at_least=True),
        Target("false_alarms", "false alarms, of {count} unfolded maps", "fold_found:share", {"folded": False}),
    ]


def _list_targets_of_corridors() -> list[Target]:
    exact, ours = {"method": OUR_METHODS, NOISE: (None, 0)}, {"method": OUR_METHODS}
    nearest, over = "least RMS of the nearest neighbour, of {count}", "PoseNet's, median over worlds"
    unsaid = "{label}: maps wrong and not said to be, of {count}"
    return [
        Target("{method}_rms_ratio", f"{{label}}: RMS / {over}", "rms_m_ratio:median", exact, per="method"),
        Target("{method}_median_ratio", f"{{label}}: median / {over}", "median_m_ratio:median", exact, per="method"),
        Target("{method}_unsaid", unsaid, "wrong_unsaid:count", ours, per="method"),
        Target("aliased_rms_m", nearest, "rms_m", {"method": "knn"}, each="recording", at_least=True),
    ]


def _list_targets_of_mds() -> list[Target]:
    plane = {"fold_found": (None, False), "outputs": 2}
    space = {**plane, "outputs": lambda count: count > 2}
    ratio, maps = "error of distances, not joined / joined", "RMS, MDS of more outputs / own of two"
    return [
        Target("apart", "distance of MDS from own, two outputs", "mds_own_m", plane, unit="mm"),
        Target("not_joined_ratio", ratio, "not_joined_ratio", plane),
        Target("planar", "planar, more outputs", "planar", space, at_least=True),
        Target("mds_ratio", maps, "mds_m", space, plane, base_of="own_m"),
    ]


_ENCODERS = (
    Target("mirrored", "maps mirrored in part, of {count}", "mirrored:count"),
    Target("rms_m {encoder}", "RMS of the map, {encoder}", "map_rms_m:median", per="encoder"),
    Target("nees {encoder}", "NEES / 2, {encoder}", "map_nees:median", per="encoder"),
)
_COST, _SMALL_REACH = "{{label}}, RMS {} / {}", f"where reach is below {100 * EDGES[SMALL_REACH_BINS]:.1f} %"
_REACH = (
    Target("{method}_little", _COST.format(_SMALL_REACH, "elsewhere"), "little", per="method"),
    Target("{method}_two_rooms", _COST.format("in two rooms", "in a rectangle"), "two_rooms", per="method"),
)
_DETECTION = Scatter(
    (("flipped", "length_error_fraction", "length errors"), ("flipped", "overlap_fraction", "overlap")),
    "start",
    ("flipped (truth) [%]", "detector [%]"),
    limit=FLIP_LIMIT,
)
_EXPECTATION = Scatter(
    (("map_expected_rms_m", "map_rms_m", ""),),
    "encoder",
    ("expected RMS error [cm]", "RMS error [cm]"),
    equal=True,
    log=True,
)
_BY_REACH = Curves(
    "kind",
    "axis",
    "share of the floor reached by straight drives [%]",
    also={"median_m": "median"},
    where={"kind": "reach"},
)
_WORLDS = Table(
    f"{VARIED_SETTINGS} method", "rms_m median_m rms_m/base median_m/base map_rms_m misplaced said turned seen"
)
_WRONG_MAPS = Table(
    f"{NOISE} method", "maps wrong said_folded said_turned said_undecided wrong_unsaid right_said_wrong", {"maps": True}
)
_MAP = "map_expected_rms_m map_nees"
REPORTS = {
    "seeds": StudyReport(
        (Table(f"{CHOICES} method", f"runs unfolded folded fold_found flipped flipped:max {ERRORS}", take="median"),),
        SEEDS_NOTE,
        name_starts,
        targets=_list_targets_of_seeds(),
        pictures={"seeds": _DETECTION},
    ),
    "maps": StudyReport(
        (
            Table("encoder", f"runs map_rms_m map_rms_m:max {_MAP} mirrored", take="median"),
            Table(VARIED_SETTINGS, f"map_rms_m {_MAP} map_flipped_m2"),
        ),
        MAPS_NOTE,
        name_encoders,
        targets=_ENCODERS,
        pictures={"maps": _EXPECTATION},
    ),
    "corridors": StudyReport(
        (_WORLDS, _WRONG_MAPS),
        CORRIDORS_NOTE,
        judge_maps,
        targets=_list_targets_of_corridors(),
        pictures={"corridors": Dots(VARIED_SETTINGS, cross={"wrong": True})},
    ),
    "concave": StudyReport(
        (COMPARE._replace(where={"kind": "run"}), Table("reach method", "positions rms_m median_m", {"kind": "reach"})),
        f"{COMPARE_NOTE} {CONCAVE_NOTE}",
        pool_by_reach,
        targets=_REACH,
        pictures={"concave": _BY_REACH, "rooms": "from_runs:draw_shapes"},
        columns="from_runs:add_reach",
        varies=(SHAPE,),
    ),
    "mds": StudyReport(
        # in a convex room no two positions are not joined
        (Table(f"{CHOICES} method", "runs outputs planar own_m mds_m mds_own_m joined_m unjoined_m folded"),),
        MDS_NOTE,
        divide_joined,
        targets=_list_targets_of_mds(),
        pictures={"mds": "mds:draw"},
        columns="mds:add_distances",
        networks=True,
    ),
}
