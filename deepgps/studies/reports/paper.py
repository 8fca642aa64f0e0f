"""The reports "rooms", "landmarks", "lidar" and "lab": our errors beside PoseNet's and the paper's."""

from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.studies.reports.record import (
    ACCEPTED_ERRORS,
    ERRORS,
    GRID,
    PAPERS_ERRORS,
    VARIED_SETTINGS,
    Dots,
    Fields,
    StudyReport,
    Table,
    Target,
)
from deepgps.studies.reports.render import add_base
from deepgps.studies.table import LEVELS, Row, split_by, split_by_label

OUR_METHODS = ("registration", "registration_distances", "deepgps_compass", "deepgps")
"""Methods whose wins are counted, each over those that are not before it."""
ROOMS_NOTE = (
    f"{GRID}Seen: share of positions within 0.25 m of a training image. Flipped: share of neighbourhoods that the map "
    "flips. Base: PoseNet."
)
SIGN_TEST = "p is from a two-sided sign test: above 0.05, these rooms do not show which of the two is more accurate."
REACH = "landmarks.reach_m"
# Table I of the paper: RMS, median and maximum [m]; it has no start from MDS.
PAPERS_LANDMARKS = {
    ("complete", "deepgps"): (0.004, 0.004, 0.021),
    ("complete", "posenet"): (0.006, 0.004, 0.024),
    ("complete", "explicit"): (0.800, 0.754, 1.613),
    ("incomplete", "deepgps"): (0.009, 0.007, 0.111),
    ("incomplete", "posenet"): (0.007, 0.006, 0.069),
    ("incomplete", "explicit"): (1.131, 0.742, 5.048),
}
LANDMARKS_NOTE = (
    "Errors in millimetres on the test grid: means over seeds, and the RMS of the worst seed; aligned on training "
    "samples, never scaled. Complete: all landmarks are visible; incomplete: only nearby ones. Explicit positioning "
    "starts at random, as in the paper, or from a map of the landmarks found by multidimensional scaling, which the "
    "paper does not use."
)
PCA = "pca_knn"
# The paper's table "ATE for 2D Lidar point cloud", a row for each of its four maps, in units of a square of side 2.
PAPERS_LIDAR = {
    "deepgps": ((0.162, 0.008, 2.449), (0.177, 0.006, 2.146), (0.178, 0.008, 2.545), (0.164, 0.008, 2.510)),
    PCA: ((0.142, 0.013, 1.980), (0.151, 0.014, 1.981), (0.177, 0.015, 2.346), (0.150, 0.014, 2.398)),
}
LIDAR_NOTE = (
    "Errors in metres on squares with a side of 2 m, as in the paper: for the worst heading of each test position, and "
    "for each scan separately, as the paper reports them. The paper's maps differ from ours; its results are assigned "
    "to our maps by number only. Aligned on training samples, never scaled. PCA + nearest neighbour uses true "
    "positions. Stored: how many numbers a method stores for positioning; in the paper, these are 2 and 66 million."
)
# Mean and standard deviation over the paper's six data sets: RMS, median and maximum [m].
PAPERS_LAB = {
    "posenet": ((0.105, 0.053), (0.032, 0.005), (0.762, 0.457)),
    "deepgps": ((0.053, 0.021), (0.036, 0.004), (0.175, 0.026)),
}
LAB_NOTE = (
    "Errors in centimetres at test samples of the same drive; aligned on training samples, never scaled. Labels "
    "are positions that the tag camera measured from images of AprilTags: PoseNet learned from them, and the "
    "first errors are measured against them, as in the paper. The other errors are measured against the "
    "simulator's truth, which the paper did not have. Unlabelled: training and test samples that show too few "
    "tags; PoseNet does not learn from them, and errors against labels exclude them. Errors of what is accepted are "
    "against the truth. Label RMS: the error of the labels themselves. The paper's figures are means and standard "
    "deviations over its six data sets."
)


def compare_with_posenet(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with PoseNet's errors on the same recording as base, where it was trained."""
    based = add_base(rows, {"method": "posenet"}, ["recording"])
    return [{**row, "won": None if (base := row["base_rms_m"]) is None else row["rms_m"] < base} for row in based]


def count_wins(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A sentence for each of our methods and each baseline: in how many common rooms ours has the lower error."""
    methods, sentences = split_by(rows, "method"), []
    for own in OUR_METHODS:
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


def compare_landmarks(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with what of the landmarks is observed, and the paper's errors."""
    prepared = []
    for row in rows:
        kind = "complete" if row.get(REACH) is None else "incomplete"
        figures = PAPERS_LANDMARKS.get((kind, row["method"]), ())
        prepared.append({**row, "observations": kind, **_add_papers("paper_{}", figures)})
    return prepared


def compare_lidar(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with the number of their map, the paper's errors, and those of the baseline on the same map."""
    prepared = []
    for number, group in enumerate(split_by_label(rows, lambda row: tuple(row[name] for name in varied)).values()):
        for row in group:
            figures = PAPERS_LIDAR.get(row["method"], ())[number : number + 1] or ((),)
            prepared.append({**row, "map": f"map {number + 1}", **_add_papers("paper_{}", figures[0])})
    based = add_base(prepared, {"method": PCA}, ["recording"], "rms_m median_m stored")
    less = [row["base_stored"] / row["stored"] if row["base_stored"] else None for row in based]
    return [
        {**row, "stored_less": times, "stored_million": row["stored"] / 1e6}
        for row, times in zip(based, less, strict=True)
    ]


def compare_lab(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with the paper's errors against labels, and as text with their standard deviations."""
    prepared = []
    for row in rows:
        figures = PAPERS_LAB.get(row["method"], ())
        texts = [f"{100 * mean:.1f} ± {100 * std:.1f}" for mean, std in figures]
        papers = _add_papers("paper_label_{}", [mean for mean, _ in figures]) | _add_papers("papers_{}", texts)
        prepared.append({**row, "data_set": row["seed"], **papers})
    return prepared


def _add_papers(name: str, figures: Sequence[float | str]) -> Row:
    return dict(zip((name.format(error) for error in PAPERS_ERRORS), figures, strict=False))


def _name_errors(prefix: str = "") -> str:
    return " ".join(prefix + name for name in PAPERS_ERRORS)


def _list_targets_of_rooms() -> list[Target]:
    ours, per, middle = {"method": OUR_METHODS}, "method", "median over rooms"
    held = {f"radius_{level}_holds": f"accepted images within their {level} % radius" for level in LEVELS}
    medians = {"rms_accepted_m": "RMS of accepted", "max_accepted_m": "max of accepted", **held}
    figures = {"rms_m": "RMS", "median_m": "median", "p95_m": "p95", "max_m": "max"}
    figures |= {f"{of}:median": f"{words}, {middle}" for of, words in medians.items()}
    names = {of: of.removesuffix(":median") for of in figures}
    return [
        *(
            Target(f"{{method}}_{name}", f"{{label}}, {figures[of]}", of, per=per, at_least=name in held)
            for of, name in names.items()
        ),
        Target("{method}_posenet_ratio", "{label}, RMS / PoseNet's RMS", "rms_m:ratio", ours, per=per),
        Target("{method}_wins", "{label}, rooms with RMS below PoseNet's", "won:share", ours, per=per, at_least=True),
        Target("train_s", "training", "train_s", {"method": "deepgps"}),
    ]


_ROOMS = Table(
    f"{VARIED_SETTINGS} method",
    f"{ERRORS} {ACCEPTED_ERRORS} relative_rms seen flipped train_s rms_m/base",
    summary="mean worst",
)
_OUR_METHOD = {"method": "deepgps"}
_TRAINING = Target("train_s", "training", "train_s", _OUR_METHOD)
_WORST_LABEL = "PCA + nearest neighbour's, worst map"
_LIDAR = (
    Target("rms_m", "RMS", "rms_m", _OUR_METHOD),
    Target("median_m", "median", "median_m", _OUR_METHOD),
    Target("rms_ratio", f"RMS / {_WORST_LABEL}", "rms_m/base", _OUR_METHOD, each="map"),
    Target("median_ratio", f"median / {_WORST_LABEL}", "median_m/base", _OUR_METHOD, each="map"),
    Target("stored_ratio", "stored by PCA / by DeepGPS", "stored_less", _OUR_METHOD, each="map", at_least=True),
    _TRAINING,
)
_LAB = (
    *(
        Target(f"{{method}}_{prefix}{name}", f"{{label}}, {title}, against {kind}", prefix + name, per="method")
        for prefix, kind in (("label_", "labels"), ("", "truth"))
        for name, title in PAPERS_ERRORS.items()
    ),
    Target("labels_rms_m", "labels' own RMS", "labels_rms_m"),
)
_OF_LANDMARKS = f"runs {_name_errors()} rms_m:max train_s {_name_errors('paper_')}"
_OF_LIDAR = f"{_name_errors()} {_name_errors('each_')} stored_million train_s {_name_errors('paper_')}"
_OF_LAB = (
    f"{_name_errors('label_')} {_name_errors()} {ACCEPTED_ERRORS} unlabelled test_unlabelled labels_rms_m train_s "
    f"{_name_errors('papers_')}"
)
_MARKS = tuple((title, f"label_{name}", name) for name, title in PAPERS_ERRORS.items())
_FIGURE = "{method}_{observations}", "RMS, {observations}, {label}", "rms_m"
REPORTS = {
    "rooms": StudyReport(
        (_ROOMS,),
        ROOMS_NOTE,
        compare_with_posenet,
        count_wins,
        _list_targets_of_rooms(),
        {"rooms": Dots(VARIED_SETTINGS)},
    ),
    "landmarks": StudyReport(
        (Table("observations method", _OF_LANDMARKS, length="mm"),),
        LANDMARKS_NOTE,
        compare_landmarks,
        targets=(Target(*_FIGURE, per="observations method", unit="mm"), _TRAINING),
        pictures={"landmarks": Dots("method", "observations")},
    ),
    "lidar": StudyReport(
        (Table("map method", _OF_LIDAR, length="m"),),
        LIDAR_NOTE,
        compare_lidar,
        targets=_LIDAR,
        pictures={"lidar": Fields("map method", (0.001, 1.0))},
        columns="from_runs:add_scans",
    ),
    "lab": StudyReport(
        (Table("data_set method", _OF_LAB, summary="mean std"),),
        LAB_NOTE,
        compare_lab,
        targets=_LAB,
        pictures={
            "lab": Dots("data_set", marks=_MARKS, words="filled: against labels, open: truth"),
            "lab_places": Fields("method"),
        },
        columns="from_runs:add_labels",
    ),
}
