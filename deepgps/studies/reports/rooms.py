"""The reports "rooms" and "corridors": errors in every room beside PoseNet's, and maps that are wrong."""

from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.studies.reports.record import (
    ACCEPTED,
    ERRORS,
    GRID,
    PAPERS_ERRORS,
    VARIED,
    Dots,
    StudyReport,
    Table,
    Target,
)
from deepgps.studies.reports.render import add_base
from deepgps.studies.table import LEVELS, Row, split_by

OURS = ("deepgps_compass", "deepgps")
"""Methods whose wins are counted, each over those that are not before it."""
NOTE = (
    f"{GRID}Seen: share of positions within 0.25 m of a training image. Flipped: share of neighbourhoods that the map "
    "flips. Base: PoseNet."
)
SIGN_TEST = "p is from a two-sided sign test: above 0.05, these rooms do not show which of the two is more accurate."
SIGNS = {"fold_found": "folded", "turned": "turned", "undecided": "undecided"}
"""Columns that say that a map is wrong, and their words: the fold detector, parts turned by the compass, the map."""
NOISE = "encoder.step_noise"
FAR_SHARE = 0.1
"""A map is wrong if it misplaces more than this share of the training images."""
CORRIDORS_NOTE = (
    f"{GRID}Map: RMS of the initial map by compass, before training. Off: share of the training images that are placed "
    f"more than 0.5 m from the truth; a map with more than {100 * FAR_SHARE:.0f} % is wrong. Said: what the "
    "method says of its map without the truth, and the share of the way that it finds turned. Seen: share of "
    "positions within 0.25 m of a training image; where it is low, errors are the drive's. PoseNet and the nearest "
    "neighbour learn from true positions, so that noise of the encoders does not change them. Base: PoseNet."
)


def compare_with_posenet(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with PoseNet's errors on the same recording as base, and the names of their figures."""
    prepared = []
    for row in add_base(rows, {"method": "posenet"}, ["recording"]):
        base, own = row["base_rms_m"], row["method"] == "deepgps"
        names = ("", "") if own else (f"{row['method']}_", f"{title_of(row['method'])}, ")
        won = None if base is None else row["rms_m"] < base
        prepared.append({**row, "won": won, "prefix": names[0], "who": names[1]})
    return prepared


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


def count_wins(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A sentence for each of our methods and each baseline: in how many common rooms ours has the lower error."""
    methods, sentences = split_by(rows, "method"), []
    for own in OURS:
        ours = {row["recording"]: row for row in methods.pop(own, [])}
        for method, group in methods.items() if ours else ():
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
    from scipy.stats import binomtest  # here, since it is slow to import

    wins, losses = sum(value < 0 for value in differences), sum(value > 0 for value in differences)
    chance = binomtest(wins, wins + losses).pvalue if wins + losses else 1.0
    return f"{wins} by {word} (p = {chance:.2g})"


def _list_targets() -> list[Target]:
    ours, per = {"method": OURS}, "method"
    means = {"rms_m": "RMS", "median_m": "median", "p95_m": "p95", "max_m": "max"}
    medians = {"rms_accepted_m": "RMS of accepted", "max_accepted_m": "max of accepted"}
    held = {f"radius_{level}_holds": f"accepted images within their {level} % radius" for level in LEVELS}
    middle = "{{who}}{}, median over rooms"
    return [
        *(Target(f"{{prefix}}{of}", f"{{who}}{words}", of, per=per) for of, words in means.items()),
        *(Target(f"{{prefix}}{of}", middle.format(words), f"{of}:median", per=per) for of, words in medians.items()),
        *(
            Target(f"{{prefix}}{of}", middle.format(words), f"{of}:median", per=per, at_least=True)
            for of, words in held.items()
        ),
        Target("{prefix}posenet_ratio", "{who}RMS / PoseNet's RMS", "rms_m:ratio", ours, per=per),
        Target("{prefix}wins", "{who}rooms with RMS below PoseNet's", "won:share", ours, per=per, at_least=True),
        Target("train_s", "training", "train_s", {"method": "deepgps"}),
    ]


def _list_targets_of_corridors() -> list[Target]:
    exact, nearest = {"method": "deepgps_compass", NOISE: (None, 0)}, "least RMS of the nearest neighbour, of {count}"
    over, unsaid = "PoseNet's, median over worlds", "{label}: maps wrong and not said to be, of {count}"
    return [
        Target("compass_rms_ratio", f"RMS / {over}", "rms_m_ratio:median", exact),
        Target("compass_median_ratio", f"median / {over}", "median_m_ratio:median", exact),
        Target("compass_unsaid", unsaid, "wrong_unsaid:count", {"method": "deepgps_compass"}),
        Target("deepgps_unsaid", unsaid, "wrong_unsaid:count", {"method": "deepgps"}),
        Target("aliased_rms_m", nearest, "rms_m", {"method": "knn"}, each="recording", at_least=True),
    ]


_ROOMS = Table(
    f"{VARIED} method",
    f"{ERRORS} {ACCEPTED} relative_rms seen flipped train_s rms_m/base",
    summary="mean worst",
)
_WORLDS = Table(f"{VARIED} method", "rms_m median_m rms_m/base median_m/base map_rms_m misplaced said turned seen")
_MAPS = Table(
    f"{NOISE} method",
    "maps wrong said_folded said_turned said_undecided wrong_unsaid right_said_wrong",
    {"maps": True},
)
REPORTS = {
    "rooms": StudyReport((_ROOMS,), NOTE, compare_with_posenet, count_wins, _list_targets(), {"rooms": Dots(VARIED)}),
    "corridors": StudyReport(
        (_WORLDS, _MAPS),
        CORRIDORS_NOTE,
        judge_maps,
        targets=_list_targets_of_corridors(),
        pictures={"corridors": Dots(VARIED, cross={"wrong": True})},
    ),
}
