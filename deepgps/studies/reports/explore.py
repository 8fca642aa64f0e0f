"""The reports "explore", "homes": how soon a drive has seen the floor, what it says of that, and homes that it maps."""

from collections.abc import Mapping, Sequence
from typing import Any

from deepgps.studies.reports.maps import FAR_SHARE
from deepgps.studies.reports.record import GRID, VARIED_SETTINGS, Scatter, StudyReport, Table, Target
from deepgps.studies.table import Point, Row

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


def draw_runs(common: Mapping[str, Any], drives: Sequence[tuple[int, Point]]) -> list[tuple[int, Point]]:
    """All drives, and after each by map one that ends when it is done; where all drives end so, those by map alone."""
    runs = []
    for seed, drive in drives:
        is_by_map, is_done = drive[HEADINGS] == "map", UNTIL in drive
        if is_by_map or not is_done:
            runs.append((seed, drive))
        if is_by_map and not is_done:
            runs.append((seed, {**drive, UNTIL: DONE_SHARE}))
    return runs


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
    (("unseen_true", "unseen", ""),),
    KIND,
    ("truly unseen [%]", "unseen by the robot's own map [%]"),
    bars=("unseen_low", "unseen_high"),
    equal=True,
    where={"done": True},
)
_HOMES = Table(
    VARIED_SETTINGS,
    "distance_m rooms entered seen rms_m median_m door_median_m rms_accepted_m accepted misplaced wrong left_out_m",
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
        draw_runs=draw_runs,
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
}
