"""The reports of studies by name, one record each. The module imports nothing heavy, so reading a study is fast."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class StudyReport:
    """What a report shows. Functions are named "module:function", with modules from ``deepgps.studies.reports``.

    Attributes:
        text: (measured rows, names that vary) -> blocks of Markdown.
        pictures: By file name, functions (measured rows, names that vary, the study's folder) -> a figure.
        measure: Measured rows -> figures that a target can be set for.
        targets: Names of these figures.
        columns: (run folder, row) -> the report's own columns in the study's table.
        draw_runs: "package.module:function" that draws the runs: (the study's ``set``, its drives as seed and settings)
            -> seeds and settings of the runs.
        varies: Settings that must vary in the study's cases or axes, by dotted name.
        sets: Settings that the study must set, or vary.
        fixes: Settings that must be a number in the study's ``set``, and cannot vary.
        networks: Whether it needs methods that train a network.
        labels: Whether it needs recordings with labels from tags.
        gather: (plans, failures, the study's folder) -> rows, of a study whose runs are diagnosed and not trained.
    """

    text: str
    pictures: Mapping[str, str] = field(default_factory=dict)
    measure: str | None = None
    targets: tuple[str, ...] = ()
    columns: str | None = None
    draw_runs: str | None = None
    gather: str | None = None
    varies: tuple[str, ...] = ()
    sets: tuple[str, ...] = ()
    fixes: tuple[str, ...] = ()
    networks: bool = False
    labels: bool = False


_COMPARED = {"errors": "compare:draw", "error_fields": "compare:draw_fields"}


def _combine(prefixes: str, names: str) -> tuple[str, ...]:
    return tuple(prefix.removeprefix("-") + name for prefix in prefixes.split() for name in names.split())


REPORTS: dict[str, StudyReport] = {
    "plain": StudyReport("compare:report_runs"),
    "rooms": StudyReport(
        "rooms:report",
        {"rooms": "rooms:draw"},
        "rooms:measure",
        (
            *_combine("- deepgps_compass_", "rms_m median_m p95_m max_m posenet_ratio wins"),
            *_combine("- deepgps_compass_", "rms_accepted_m max_accepted_m radius_68_holds radius_95_holds"),
            *("train_s", "posenet_rms_m", "posenet_median_m", "posenet_max_m"),
        ),
    ),
    "seeds": StudyReport(
        "maps:report_seeds", {"seeds": "maps:draw_seeds"}, "maps:measure_seeds", ("unfolded", "found", "false_alarms")
    ),
    "landmarks": StudyReport(
        "paper:report_landmarks",
        {"landmarks": "paper:draw_landmarks"},
        "paper:measure_landmarks",
        (*_combine("deepgps_ posenet_ explicit_ explicit_mds_", "complete incomplete"), "train_s"),
    ),
    "compare": StudyReport("compare:report", _COMPARED),
    "networks": StudyReport(
        "compare:report_networks",
        _COMPARED,
        "compare:measure_networks",
        (
            *("spectral", "invariant", "resnet", "resnet_paper", "resnet_plain"),
            *("spectral_turned", "invariant_turned", "plain_ratio", "plain_turned"),
        ),
        "compare:add_turn_spread",
        varies=("learn.network.architecture",),
    ),
    "strategies": StudyReport(
        "compare:report",
        _COMPARED,
        "compare:measure_strategies",
        ("travel_ratio", "samples_ratio", "way_ratio"),
        varies=("drive.strategy", "drive.samples"),
    ),
    "mds": StudyReport(
        "mds:report",
        {"mds": "mds:draw"},
        "mds:measure",
        ("apart", "not_joined_ratio", "planar", "mds_ratio"),
        "mds:add_distances",
        networks=True,
    ),
    "concave": StudyReport(
        "maps:report_concave",
        {"concave": "maps:draw_concave", "rooms": "maps:draw_shapes"},
        "maps:measure_concave",
        _combine("deepgps_ posenet_", "little two_rooms"),
        "maps:add_reach",
        varies=("room.shape",),
    ),
    "curves": StudyReport(
        "curves:report",
        {"curves": "curves:draw"},
        "curves:measure",
        ("rms_m", "relative_rms", "relative_median", "knee"),
    ),
    "encoder": StudyReport(
        "encoder:report",
        {"encoder": "encoder:draw", "near": "encoder:draw_near"},
        "encoder:measure",
        (
            *_combine("- aware_", "rms_w ticks_16 ticks_4"),
            *_combine("compass_", "w radius slip stuck_rms_m stuck_folded curves_1 curves_3"),
        ),
        "encoder:add_errors",
    ),
    "camera": StudyReport(
        "changes:report",
        {"camera": "changes:draw"},
        "changes:measure",
        (
            *("clean_rms_m", *_combine("both_ deployment_", "rms_ratio median_ratio")),
            *_combine("compass_tilted_ compass_knocked_", "2_ratio 8_ratio"),
        ),
    ),
    "change": StudyReport(
        "changes:report_changes",
        {"change": "changes:draw_changes"},
        "changes:measure_changes",
        ("light_0.5_ratio", "light_0.2_ratio", "lamps_0_ratio", "mixed_ratio", "person_ratio"),
        varies=("drive.mixed_light",),
    ),
    "knowing": StudyReport(
        "knowing:report",
        {"knowing": "knowing:draw"},
        "knowing:measure",
        (
            *("drives_right", "images_right"),
            *("clean_refused", "moved_refused", "other_room_refused", "covered_refused"),
        ),
        "knowing:add_drives",
        sets=("deployment.drive_samples",),
    ),
    "corridors": StudyReport(
        "rooms:report_corridors",
        {"corridors": "rooms:draw_corridors"},
        "rooms:measure_corridors",
        ("compass_rms_ratio", "compass_median_ratio", "compass_unsaid", "deepgps_unsaid", "aliased_rms_m"),
    ),
    "maps": StudyReport("maps:report", {"maps": "maps:draw"}, "maps:measure", ("mirrored",)),
    "diagnose": StudyReport(
        "diagnose:report",
        {"diagnose": "diagnose:draw"},
        "diagnose:measure",
        (
            *("recall", "recall_all", "precision", "false_alarms", "false_alarms_alike"),
            *("coverage_least", "coverage_most", "track_error", "ratio_error"),
        ),
        draw_runs="deepgps.studies.diagnose_runs:draw_runs",
        gather="diagnose:gather_diagnoses",
        fixes=("drive.samples",),
    ),
    "lidar": StudyReport(
        "paper:report_lidar",
        {"lidar": "paper:draw_lidar"},
        "paper:measure_lidar",
        ("rms_m", "median_m", "rms_ratio", "median_ratio", "stored_ratio", "train_s"),
        "paper:add_scans",
    ),
    "lab": StudyReport(
        "paper:report_lab",
        {"lab": "paper:draw_lab_errors", "lab_places": "paper:draw_lab_places"},
        "paper:measure_lab",
        (
            *_combine("deepgps_label_ deepgps_ posenet_label_ posenet_", "rms_m median_m max_m"),
            "labels_rms_m",
        ),
        "paper:add_labels",
        labels=True,
    ),
}
PICTURES = tuple(sorted({name for report in REPORTS.values() for name in report.pictures}))
"""Names of all pictures that studies draw."""
