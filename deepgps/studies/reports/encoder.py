"""The report "encoder": what faults cost as they grow, what theory predicts for them, and which encoder is enough."""

from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.studies.reports.record import Curves, StudyReport, Table, Target
from deepgps.studies.table import Row, mean, split_by, varied_in
from sim.sensors.encoder import FAULTS
from sim.settings import EncoderSettings, RobotSettings

Names = tuple[str, ...]
WHEEL_ERROR = "robot.wheel_radius_error"
FAULTLESS_VALUES = {
    **{f"encoder.{name}": value for name, value in EncoderSettings().model_dump().items()},
    WHEEL_ERROR: RobotSettings().wheel_radius_error,
}
"""Settings of encoders and wheels, and their values without faults."""
TICKS, NOISE, SLIP = "encoder.ticks_per_rev", "encoder.step_noise", "encoder.slip_per_m"
RADIUS, STUCK_FRACTION = "encoder.radius_error_left", "encoder.stuck_fraction"
TITLES: dict[Names, str] = {
    (TICKS,): "ticks per revolution",
    (RADIUS,): "error of one wheel's radius",
    **{tuple(f"encoder.{name}" for name in fault.settings): fault.title for fault in FAULTS},
    (WHEEL_ERROR,): "left wheel larger by this part: the robot curves",
}
PAIRS = (("registration_distances", "registration"), ("deepgps", "deepgps_compass"))
"""Methods on a map by distances alone and, with the same estimator, by compass."""
REAL_FAULTS = ("radius_error_left", "radius_error_right", "slip_per_m", "step_noise", "ticks_per_rev", "track_error")
COMBINATIONS = {tuple(f"encoder.{name}" for name in REAL_FAULTS): f"a small real robot: {', '.join(REAL_FAULTS)}"}
NEARNESS_M = (0.02, 0.05)  # Errors that count as good enough, for two kinds of builders [m]
GOOD_SHARE = 0.8  # The part of the test positions whose errors must be good enough
NOTE = (
    f"The strongest fault at which at least {100 * GOOD_SHARE:g} % of the test positions, each at its worst heading, "
    "are still within this distance of the truth (mean over seeds) is enough. RMS is not the criterion, since it is "
    "dominated by a few positions with large errors that no encoder can reduce.\n\n"
    "RMS in centimetres for the worst heading of each test position: mean, minimum and maximum over seeds. Near: share "
    f"of the test positions with errors within {100 * NEARNESS_M[0]:g} cm. Aligned on training samples, never scaled. "
    "Segment: RMS error of the lengths of complete segments, measured and predicted by theory (rounding is uniform "
    "within a tick; the error from w grows with the root of the number of gaps, slip with the root of the distance "
    "travelled, a radius error in proportion to it; a stuck encoder halves the distance). The error that remains "
    "without faults is due to the wheels creeping on the floor. A map can be more accurate than its segments because "
    "many segments cross each place and their errors average out. It is less accurate if all segments have the same "
    "error, or if segments are so accurate that the network and poorly covered places limit the map.\n\n"
    "- Rounding should hardly matter while a tick is short compared with the spacing of images, since the phases of "
    "the ticks differ.\n"
    "- A radius error on both wheels enlarges the map by the same fraction, and an error on one wheel by half of it. "
    "The position error is that fraction of the distance from the middle of the room, and only the scale of the map "
    "shows it; no method without known positions can detect it.\n"
    "- Distances along segments depend neither on the track width nor on turns, so errors in these affect only dead "
    "reckoning.\n"
    "- When readings are lost, DeepGPS loses their images, but the distances between the remaining ones stay correct. "
    "PoseNet still learns from all images, but the features that both methods use are chosen along the segments, whose "
    "images are then farther apart."
)


def name_near(near_m: float) -> str:
    """The name of the column for the part of the test positions with errors of at most ``near_m`` [m]."""
    return f"within_{100 * near_m:g}_cm"


def find_sweeps(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """A row for each sweep that a run is part of: of each fault that grows alone, or of several, from no fault on.

    A sweep holds the rows without any fault; that of several also those with some of them, as strong as together.
    The smallest fault comes first. Further rows say which fault of a sweep a method bears.
    """
    changed = [(_list_changed(row), row) for row in rows]
    alone = [names for names in TITLES if any(names == found for found, _ in changed)]
    several = {names for names, _ in changed if len(names) == 2 or names in COMBINATIONS}
    pairs, titles = sorted(several - set(TITLES)), {**TITLES, **COMBINATIONS}
    sweeps, borne = [], []
    for names in (*alone, *pairs):
        title = titles.get(names) or " with ".join(titles.get((name,), name) for name in names)
        ours = [row for found, row in changed if found in ((), names) or (names in pairs and set(found) < set(names))]
        grown = _grow_pair(names, ours) if names in pairs else _grow_alone(names, ours)
        for row in grown:
            excess = None if row["scale"] is None else row["scale"] - 1.0
            sweeps.append({**row, "sweep": title, "map_too_large": excess})
        for method, group in split_by(grown if names in alone else (), "method").items():
            for near in NEARNESS_M:
                strongest = find_strongest(near, group, TICKS in names)
                borne.append({"sweep": title, "near": near, "method": method, "strongest": strongest})
    return [*borne, *sweeps]


def _grow_alone(names: Names, rows: Sequence[Row]) -> list[Row]:
    """Rows of a fault by its value; both radii grow together only where they are the same."""
    same = [row for row in rows if len({row[name] for name in names}) == 1]
    grown = sorted(same, key=lambda row: -row[TICKS] if TICKS in names else abs(row[names[0]]))
    return [{**row, "pair": False, "value": row[names[0]], "enough": GOOD_SHARE} for row in grown]


def _grow_pair(names: Names, rows: Sequence[Row]) -> list[Row]:
    """Rows of a pair of faults by both values, of those that the pair has together."""
    asked = [{FAULTLESS_VALUES[name], *(row[name] for row in rows if _list_changed(row) == names)} for name in names]
    rows = [row for row in rows if all(row[name] in known for name, known in zip(names, asked, strict=True))]
    grown = sorted(rows, key=lambda row: [row[name] for name in names])
    return [{**row, "pair": True, "value": ", ".join(f"{row[name]:g}" for name in names)} for row in grown]


def _list_changed(row: Row) -> Names:
    return tuple(
        sorted(name for name in varied_in(row) if name in FAULTLESS_VALUES and row[name] != FAULTLESS_VALUES[name])
    )


def find_strongest(near_m: float, rows: Sequence[Row], fewer_is_worse: bool) -> str:
    """The strength of a sweep up to which ``GOOD_SHARE`` of a method's positions stay within ``near_m`` [m]."""
    groups, good = split_by(rows, "value"), []
    for value, group in groups.items():
        if mean(group, name_near(near_m)) < GOOD_SHARE:
            break
        good.append(value)
    if not good:
        return "none is enough"
    if len(good) == len(groups):
        return f"all, to {good[-1]:g}"
    return f"{good[-1]:g}" if fewer_is_worse or len(good) > 1 else "none tolerated"


def _list_targets() -> list[Target]:
    def select(method: str, setting: str, value: float) -> dict:
        return {"method": method, "sweep": TITLES[setting,], "value": value}

    targets = []
    for alone, compass in PAIRS:
        perfect, title = select(alone, TICKS, FAULTLESS_VALUES[TICKS]), title_of(alone)
        targets.append(Target(f"{alone}_rms_w", f"{title}: RMS at w = 0.10", "rms_m", select(alone, NOISE, 0.1)))
        for ticks in (16, 4):
            words = f"{title}: RMS at {ticks} ticks / perfect"
            targets.append(Target(f"{alone}_ticks_{ticks}", words, "rms_m", select(alone, TICKS, ticks), perfect))
        for key, setting, value in (("w", NOISE, 0.3), ("radius", RADIUS, 0.01), ("slip", SLIP, 0.1)):
            ours, theirs = (select(name, setting, value) for name in (compass, alone))
            words = f"{title_of(compass)}: RMS / {title}'s, {TITLES[setting,]} {value:g}"
            targets.append(Target(f"{compass}_{key}", words, "rms_m", ours, theirs))
        title, straight = title_of(compass), select(compass, WHEEL_ERROR, 0.0)
        stuck, words = select(compass, STUCK_FRACTION, 0.5), "one encoder stuck for half of the drive"
        targets.append(Target(f"{compass}_stuck_rms_m", f"{title}: RMS, {words}", "rms_m", stuck))
        words = f"{title}: maps folded of {{count}}, {words}"
        targets.append(Target(f"{compass}_stuck_folded", words, "folded:count", stuck))
        for value in (0.01, 0.03):
            words = f"{title}: median / without faults, left wheel larger by {100 * value:g} %"
            curved = select(compass, WHEEL_ERROR, value)
            targets.append(Target(f"{compass}_curves_{100 * value:g}", words, "median_m", curved, straight))
    return targets


_SINGLE_FAULTS = {"pair": False}
_ERRORS = Curves(
    "sweep",
    "value",
    also={"map_expected_rms_m": "expected by its map"},
    lines={"segment_expected_m": "one segment, theory", "segment_rms_m": "one segment, measured"},
    even=True,
    where=_SINGLE_FAULTS,
)
_GOOD_SHARES = Curves(
    "sweep",
    "value",
    of=name_near(NEARNESS_M[0]),
    unit=f"positions within {100 * NEARNESS_M[0]:g} cm [%]",
    lines={"enough": "good enough"},
    even=True,
    where=_SINGLE_FAULTS,
)
_SWEEPS = Table(
    "value method",
    f"rms_m rms_m:min rms_m:max {name_near(NEARNESS_M[0])} segment_rms_m segment_expected_m map_too_large "
    "wrong_doubted segments_wrong",
    {"near": None},
    section="sweep",
)
_CHOICE = "Which encoder keeps most of the room within {:g} cm"
REPORTS = {
    "encoder": StudyReport(
        (
            *(
                Table("sweep", "", {"near": near}, None, _CHOICE.format(100 * near), across="method", each="strongest")
                for near in NEARNESS_M
            ),
            _SWEEPS,
        ),
        NOTE,
        find_sweeps,
        targets=_list_targets(),
        pictures={"encoder": _ERRORS, "near": _GOOD_SHARES},
        columns="from_runs:add_errors",
    ),
}
