"""The reports "explore", "homes", "corridors": drives that see a floor, homes, and worlds that look alike."""

from collections.abc import Sequence

from deepgps.studies.reports.paper import OUR_METHODS, compare_with_posenet
from deepgps.studies.reports.record import GRID, VARIED_SETTINGS, Dots, Scatter, StudyReport, Table, Target
from deepgps.studies.table import Row

HEADINGS, KIND, SEED, UNTIL = "drive.headings", "room.kind", "room.seed", "drive.until.unseen"
DONE_SHARE = 0.005  # Share of the floor that is unseen when a drive by map is done
EXPLORE_NOTE = (
    f"Images: until {100 * (1 - DONE_SHARE):g} % of the floor that the robot can reach is within 0.25 m of one, by the "
    "truth; of a drive that ends before, all of them. Over explore: over those of `explore` in the same room. Done: "
    f"drives that end when the robot's own map has at most {100 * DONE_SHARE:g} % unseen. Unseen: what that map says "
    "then, at least, at most, and the truth. No image is drawn: a lidar takes their place, and the robot drives alike."
)
HOMES_NOTE = (
    f"{GRID}Entered: rooms, the hall included, in which an image is within half a metre of the middle of their largest "
    "free floor. Doors: median at test positions within 0.6 m of one. Off: share of the training images that are "
    "placed more than 0.5 m from the truth; a map is wrong from 10 %. Radius: what the run says of itself."
)
NOISE = "encoder.step_noise"
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


def compare_with_explore(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with images over those of ``explore``, and how far the share unseen is from what was said [points]."""
    usual = {row[SEED]: row["images_needed"] for row in rows if row[HEADINGS] == "explore"}
    compared = []
    for row in rows:
        is_done, theirs = row[UNTIL] is not None, usual.get(row[SEED])
        low, high, true = row["unseen_low"], row["unseen_high"], row["unseen_true"]
        said = {"apart": abs(row["unseen"] - true), "holds": low <= true <= high} if is_done else {}
        over = {} if is_done else {"images_explore": theirs, "over_explore": theirs and row["images_needed"] / theirs}
        empty = dict.fromkeys(("images_explore", "over_explore", "apart", "holds"))
        compared.append({**row, **empty, **over, **said, "done": is_done})
    return compared


def judge_homes(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with whether the map of a home is wrong."""
    return [{**row, "wrong": row["misplaced"] > FAR_SHARE} for row in rows]


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


_PLANNERS = Table(
    HEADINGS,
    "runs images_needed:median images_needed:max reached over_explore:median over_explore:min over_explore:max",
    {"done": False},
    title="Images until the floor is seen",
)
_ROOMS = Table(f"{KIND} room.shape {SEED}", "", {"done": False}, across=HEADINGS, each="images_needed")
_DONE = Table(
    f"{KIND} room.shape {SEED}",
    "samples distance_m unseen unseen_low unseen_high unseen_true",
    {"done": True},
    title="Done",
)
_PROMISES = Scatter(
    "unseen_true",
    "unseen",
    KIND,
    ("truly unseen [%]", "unseen by the robot's own map [%]"),
    bars=("unseen_low", "unseen_high"),
    where={"done": True},
)
_HOMES = Table(
    VARIED_SETTINGS,
    "distance_m rooms entered seen rms_m median_m door_median_m rms_accepted_m accepted misplaced wrong left_out_m",
)
_WORLDS = Table(
    f"{VARIED_SETTINGS} method", "rms_m median_m rms_m/base median_m/base map_rms_m misplaced said turned seen"
)
_WRONG_MAPS = Table(
    f"{NOISE} method", "maps wrong said_folded said_turned said_undecided wrong_unsaid right_said_wrong", {"maps": True}
)
REPORTS = {
    "explore": StudyReport(
        (_PLANNERS, _ROOMS, _DONE),
        EXPLORE_NOTE,
        compare_with_explore,
        targets=(
            Target("images_ratio", "images, map / explore, median room", "over_explore:median", {HEADINGS: "map"}),
            Target("apart", "unseen, said and true, mean difference", "apart", {"done": True}, unit="%"),
            Target("holds", "true share within what was said, {count}", "holds:share", {"done": True}, at_least=True),
        ),
        pictures={"explore": _PROMISES},
        columns="from_runs:add_explored",
        varies=(HEADINGS, KIND),
    ),
    "homes": StudyReport(
        (_HOMES,),
        HOMES_NOTE,
        judge_homes,
        targets=(
            Target("missed", "flats with a room not entered, of {count}", "missed:count"),
            Target("median_m", "median error, median flat", "median_m:median"),
            Target("rms_accepted_m", "RMS of accepted, median flat", "rms_accepted_m:median"),
            Target("wrong", "maps wrong, of {count}", "wrong:count"),
        ),
        columns="from_runs:add_home",
    ),
    "corridors": StudyReport(
        (_WORLDS, _WRONG_MAPS),
        CORRIDORS_NOTE,
        judge_maps,
        targets=_list_targets_of_corridors(),
        pictures={"corridors": Dots(VARIED_SETTINGS, cross={"wrong": True})},
    ),
}
