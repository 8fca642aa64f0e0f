"""What each report makes of its rows: what is compared with what, what counts as right, and which figures follow."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.reports.plots import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.reports import changes, compare, encoder, paper, worlds
from deepgps.studies.reports.diagnose import QUANTITIES
from deepgps.studies.reports.encoder import FAULTLESS_VALUES, find_sweeps
from deepgps.studies.reports.pictures import draw
from deepgps.studies.reports.render import prepare
from deepgps.studies.reports.worlds import HEADINGS, SEED, UNTIL, compare_with_explore
from deepgps.studies.study import load_study
from deepgps.studies.table import Row, split_by
from tests.helpers.reports import find_line, read_cells, report_rows, values_of

ERRORS = {"rms_m": 1.0, "median_m": 0.5, "p95_m": 2.0, "max_m": 10.0}


def make_row(rms: float, method: str = "deepgps", **columns: object) -> Row:
    found = None if method == "posenet" else False
    errors = {name: rms * share for name, share in ERRORS.items()}
    return {"method": method, "seed": 0, "flipped": 0.0, "fold_found": found, "scale": 1.0, **errors, **columns}


# --- compare

SLIP = "encoder.slip_per_m"
CASES = [("none", 0.0, 0.02), ("carpet", 0.02, 0.03), ("rug", 0.05, 0.09)]


@given(st.lists(st.floats(-0.01, 0.01), min_size=2, max_size=6))
def test_cases_are_compared_with_the_first_one_of_the_same_seed_and_ranked(luck: list[float]) -> None:
    rows = [
        make_row(rms + one, rms_accepted_m=rms + one, median_m=rms + one, case=name) | {SLIP: slip, "seed": seed}
        for name, slip, rms in CASES
        for seed, one in enumerate(luck)
    ]
    text, _ = report_rows("compare", rows, ["case", SLIP, "seed"])
    assert max(map(len, read_cells(text, headings=True))) <= 8
    for name, _, rms in CASES[1:]:
        added = 100 * (rms - CASES[0][2])
        assert find_line(text, name)[3:5] == [f"{added:.2f}", f"{added:.2f} to {added:.2f}"]  # luck is no difference
    assert "What adds most to none, DeepGPS:** rug +7.00, carpet +1.00 cm" in text


def test_cases_whose_interval_holds_no_difference_are_not_told_apart() -> None:
    rows = [
        make_row(0.1, rms_accepted_m=0.1, median_m=median, case=name, seed=seed)
        for name, medians in (("none", (0.01, 0.02)), ("ticks", (0.02, 0.01)), ("slip", (0.03, 0.0402)))
        for seed, median in enumerate(medians)
    ]
    text, _ = report_rows("compare", rows, ["case", "seed"])
    assert "What adds most to none, DeepGPS:** slip +2.01, ticks +0.00 (not told apart) cm" in text


def test_a_case_without_a_name_is_named_by_what_it_changes() -> None:
    ticks = "encoder.ticks_per_rev"
    points = [(4096, 0.0), (64, 0.0), (4096, 0.02), (64, 0.02)]
    rows = [make_row(0.1, **{ticks: one, SLIP: slip}) for one, slip in points]
    words = ["ticks per rev 64", "slip per m 0.02", "ticks per rev 64, slip per m 0.02"]
    assert compare.name_cases(rows, [ticks, SLIP]) == ["no change", *words]


# --- curves

SAMPLES = (500.0, 1000.0, 4000.0, 16000.0)
Lines = dict[tuple[str, str], dict[float, tuple[float, ...]]]


def make_curves(rms: Lines, axis: str = "encoder.step_noise") -> list[Row]:
    """A row for each scenario, method, value of the axis and seed, in the order of a table's columns."""
    return [
        {"run": "r", "seed": seed, "learn.knob": 1, "scenario": scenario, axis: value, "samples": 100, "failure": None}
        | make_row(one, method, shorter_side_m=2.0, relative_rms=one / 2.0)
        | {"seed": seed}
        for (scenario, method), line in rms.items()
        for value, seeds in line.items()
        for seed, one in enumerate(seeds)
    ]


NOISE = make_curves(
    {
        ("landmarks", "deepgps"): {0.0: (0.001, 0.003), 0.1: (0.004, 0.006)},
        ("landmarks", "posenet"): {0.0: (0.002, 0.002), 0.1: (0.002, 0.002)},
        ("living_room", "deepgps"): {0.0: (0.02, 0.02), 0.1: (0.03, 0.05)},
    }
)


def make_line(*rms: float) -> list[Row]:
    line = dict(zip(SAMPLES, ((one,) for one in rms), strict=True))
    return make_curves({("living_room", "deepgps"): line}, "drive.samples")


def test_the_knee_is_where_the_line_becomes_flat_and_the_paper_has_one_value() -> None:
    text, figures = report_rows("curves", make_line(0.2, 0.08, 0.049, 0.04), ["drive.samples"])
    assert figures["deepgps_knee"].value == 4000
    assert "drive.samples 4000, the smallest value" in text
    heading, *lines = read_cells(text, headings=True)
    place = heading.index("paper rms [cm]")
    assert [line[place] for line in lines] == ["-", "4.00", "-", "-"]
    still_falling = report_rows("curves", make_line(0.2, 0.08, 0.06, 0.04), ["drive.samples"])
    assert "deepgps_knee" not in still_falling[1] and "knee" not in still_falling[0]


@given(rms=st.tuples(*[st.floats(0.001, 1.0)] * 4))
def test_from_the_knee_on_all_are_within_and_the_one_before_is_not(rms: tuple[float, ...]) -> None:
    knee, within = compare.find_knee(make_line(*rms), "drive.samples"), [one <= compare.KNEE * rms[-1] for one in rms]
    if knee is None:
        assert all(within) or not within[-2]
    else:
        place = SAMPLES.index(knee)
        assert all(within[place:]) and not within[place - 1] and place < len(rms) - 1


def test_curves_run_through_the_means_and_bands_from_best_to_worst() -> None:
    def draw_panels(rows: list[Row], varied: list[str]):
        report = REPORTS["curves"]
        return draw(report.pictures["curves"], prepare(report, rows, varied), varied, Path()).axes

    panels = draw_panels(NOISE, ["scenario", "encoder.step_noise"])
    assert [axes.get_title() for axes in panels] == ["landmarks", "living_room"]
    lines = {str(line.get_label()): line for line in panels[0].lines}
    np.testing.assert_allclose(np.asarray(lines["DeepGPS"].get_ydata()), [0.2, 0.5])
    np.testing.assert_allclose(np.asarray(lines["DeepGPS, median"].get_ydata()), [0.1, 0.25])
    np.testing.assert_allclose(np.asarray(lines["paper: below this share of the side"].get_ydata()), 4.0)
    band = np.asarray(panels[0].collections[0].get_paths()[0].vertices)
    np.testing.assert_allclose([band[:, 1].min(), band[:, 1].max()], [0.1, 0.6])
    (panel,) = draw_panels(make_line(0.2, 0.08, 0.05, 0.04), ["drive.samples"])
    assert (panels[0].get_xscale(), panel.get_xscale(), panel.get_yscale()) == ("linear", "log", "log")
    (theirs,) = [line for line in panel.lines if line.get_label() == "paper's RMS"]
    assert np.asarray(theirs.get_xydata()).tolist() == [[1000.0, 4.0]]


# --- rooms, corridors


def test_wrong_maps_are_counted_by_what_is_said_of_them() -> None:
    own = {"misplaced": 0.02, "undecided": None, "turned": 0.0, "seen": 0.9, worlds.NOISE: 0.0}
    noisy = {**own, "misplaced": 0.6, worlds.NOISE: 0.3}
    rows = [
        make_row(0.3, "deepgps_compass", recording="0", **own),
        make_row(0.2, "posenet", recording="0", **{**own, "misplaced": None}),
        make_row(2.0, "deepgps_compass", recording="1", **{**noisy, "undecided": True}),
        make_row(2.0, "deepgps_compass", recording="2", **{**noisy, "undecided": False}),
        make_row(2.0, recording="0", **{**own, "misplaced": 0.4}) | {"fold_found": True},
        make_row(0.3, recording="1", **{**own, "turned": 0.1}) | {"fold_found": True},
    ]
    (text, figures), ours = report_rows("corridors", rows, [worlds.NOISE]), "deepgps_compass"
    assert read_cells(text)[-3:] == [
        ["0", "DeepGPS, compass", "1", "0", "0", "0", "-", "0", "0"],
        ["0.3", "DeepGPS, compass", "2", "2", "0", "0", "1", "1", "0"],
        ["0", "DeepGPS", "2", "1", "2", "1", "-", "0", "1"],
    ]
    assert (figures[f"{ours}_rms_ratio"].value, figures[f"{ours}_unsaid"].value) == (pytest.approx(1.5), 1)
    assert set(values_of("corridors", [{**rows[1], "method": "knn"}])) == {"aliased_rms_m"}


# --- faults and changes

FAULTS = ["image_faults.exposure", "deployment.light", "camera_mount.roll_deg", "seed"]


def make_fault(
    rms: float, exposure: float = 1.0, light: float = 1.0, method: str = "deepgps", lean: float = 0.0
) -> Row:
    faults = {"image_faults.exposure": exposure, "deployment.light": light, "camera_mount.roll_deg": lean}
    return {**make_row(rms, method), **faults}


FAULTY_RUNS = [make_fault(0.04, light=0.5), make_fault(0.02), make_fault(0.03, exposure=0.25), make_fault(0.05, 0.25)]


def test_without_a_run_without_faults_there_is_nothing_to_compare_with() -> None:
    text, figures = report_rows("camera", FAULTY_RUNS[:1], FAULTS)
    assert figures == {}
    assert "base" not in text.partition("\n")[0]


def test_a_leaning_camera_with_another_fault_does_not_count_as_one_that_leans() -> None:
    rows = [
        make_fault(rms, exposure, method="deepgps_compass", lean=degrees)
        for rms, exposure, degrees in ((0.01, 1.0, 0.0), (0.02, 1.0, 8.0), (0.50, 0.25, 8.0), (0.50, 0.25, 2.0))
    ]
    assert values_of("camera", rows, FAULTS) == pytest.approx({"compass_tilted_8_ratio": 2.0})


def test_a_study_of_changes_on_one_kind_of_features_needs_not_vary_it() -> None:
    varied = ["deployment.light", changes.LIGHT]
    rows = [
        make_row(rms, "deepgps_compass", **{"deployment.light": light, changes.LIGHT: False})
        for rms, light in ((0.01, 1.0), (0.02, 0.2))
    ]
    text, figures = report_rows("change", rows, varied)
    assert text.startswith("## Trained in one light\n")
    assert figures["light_0.2_ratio"].value == pytest.approx(2.0)
    assert values_of("change", rows[1:], varied) == {}
    report = REPORTS["change"]
    picture = draw(report.pictures["change"], prepare(report, rows, varied), varied, Path())
    assert to_png(picture).startswith(b"\x89PNG")
    assert [tick.get_text() for tick in picture.axes[0].get_yticklabels()] == ["no change", "all light x 0.2"]


# --- encoders

NAMES = (
    *("encoder.ticks_per_rev", "encoder.step_noise", "encoder.radius_error_left", "encoder.radius_error_right"),
    *("encoder.slip_per_m", "encoder.stuck_fraction", "robot.wheel_radius_error", "encoder.track_error"),
)
TICKS, W, LEFT_RADIUS, RIGHT_RADIUS = NAMES[:4]
SHARES = (("deepgps", 1.0), ("deepgps_compass", 0.5))


def make_sweeps(rms: dict[tuple, float], shares: tuple[tuple[str, float], ...] = SHARES) -> list[Row]:
    """Two seeds of the methods for each set of faults; each method has its share of the error."""
    rows = []
    for faults, error in rms.items():
        settings = {name: dict(faults).get(name, FAULTLESS_VALUES[name]) for name in NAMES}
        for method, share in shares:
            for seed in (0, 1):
                row = {"run": "r", "seed": seed, **settings, "samples": 100, "method": method, "scale": 1.0}
                row |= {"rms_m": share * error * (1 + 0.1 * seed), "median_m": share * error / 10, "failure": None}
                row |= {"flipped": 0.3 if error > 0.2 else 0.01}
                row |= {"within_2_cm": 1.0 - 10 * share * error, "within_5_cm": 1.0 - 3 * share * error}
                row |= {"segment_rms_m": error, "segment_expected_m": error, "wrong_doubted": 3, "segments_wrong": 4}
                rows.append(row)
    return rows


SWEEPS = make_sweeps(
    {
        (): 0.01,
        ((TICKS, 64),): 0.0105,
        ((TICKS, 16),): 0.011,
        ((TICKS, 4),): 0.03,
        ((W, 0.1),): 0.025,
        ((LEFT_RADIUS, 0.02), (RIGHT_RADIUS, 0.02)): 0.04,
        ((LEFT_RADIUS, 0.02),): 0.02,
        ((W, 0.1), (TICKS, 4)): 0.05,
    }
)


def list_values(rows: list[Row]) -> dict[str, list]:
    sweeps = split_by([row for row in find_sweeps(rows, []) if "value" in row], "sweep")
    return {sweep: list(split_by(some, "value")) for sweep, some in sweeps.items()}


def test_faults_are_told_apart_from_pairs_of_them_and_grow_from_none() -> None:
    assert list_values(SWEEPS) == {
        "ticks per revolution": [4096, 64, 16, 4],
        "noise w of each gap": [0.0, 0.1],
        "error of one wheel's radius": [0.0, 0.02],
        "error of both wheels' radius": [0.0, 0.02],
        "noise w of each gap with ticks per revolution": ["0, 4", "0, 4096", "0.1, 4", "0.1, 4096"],
    }
    real = make_sweeps({(): 0.01, tuple((name, 0.5) for name in next(iter(encoder.COMBINATIONS))): 0.02})
    assert [len(values) for sweep, values in list_values(real).items() if sweep.startswith("a small real robot")] == [2]
    either_sign = make_sweeps({((LEFT_RADIUS, error),): 0.01 for error in (-0.1, 0.0, 0.02)})
    assert list_values(either_sign) == {"error of one wheel's radius": [0.0, 0.02, -0.1]}


# --- the paper


def test_the_papers_figures_are_those_of_its_tables() -> None:
    landmarks, lab = (load_study(name, tiny=False).paper for name in ("landmarks", "lab"))
    assert landmarks == {f"{method}_{kind}": one[0] for (kind, method), one in paper.PAPERS_LANDMARKS.items()}
    assert lab == {
        f"{method}_label_{name}": figures[place][0]
        for method, figures in paper.PAPERS_LAB.items()
        for place, name in enumerate(paper.PAPERS_ERRORS)
    }
    lidar = load_study("lidar", tiny=False).paper
    ours, baseline = (np.array(paper.PAPERS_LIDAR[name]) for name in ("deepgps", "pca_knn"))
    worst = (ours / baseline).max(axis=0)
    assert (lidar["rms_ratio"], lidar["median_ratio"]) == pytest.approx(tuple(worst[:2]), abs=0.005)
    assert (lidar["rms_m"], lidar["median_m"]) == pytest.approx(tuple(ours.mean(axis=0)[:2]), abs=0.0005)


# --- diagnoses


def diagnosed(made: str, found: str, must: str | None = None, track_m: float = 0.16) -> Row:
    """A recording: the faults that were set, found, and large enough; all intervals hold if ``track_m`` is 0.16."""
    true = {**dict.fromkeys(QUANTITIES, 0.0), "track_m": 0.16, "reading_ratio": 1.0, "wheel_ratio": 1.0}
    values = {**true, "track_m": track_m}
    ends = {f"{name}_{end}": value for name, value in values.items() for end in ("low", "high")}
    truth = {f"{name}_true": value for name, value in true.items()}
    return {"set": made, "found": found, "must": made if must is None else must, **values, **ends, **truth}


def test_what_counts_as_right() -> None:
    rows = [diagnosed(*names) for names in (("", ""), ("", "slip"), ("radius", "radius"), ("radius slip", "radius"))]
    rows += [diagnosed("ticks", "", ""), diagnosed("alike", "track"), diagnosed("alike", "track radius")]
    text, figures = report_rows("diagnose", [*rows, diagnosed("track", "track", track_m=0.17)])
    values = {name: figure.value for name, figure in figures.items()}
    assert values["recall"] == pytest.approx(3 / 4), "a fault too small to be told need not be found"
    assert values["precision"] == pytest.approx(5 / 7)
    assert (values["false_alarms"], values["false_alarms_alike"]) == (1, 1)
    assert values["coverage_least"] == pytest.approx(7 / 8)
    assert figures["track_error"].worst == pytest.approx(1 / 16)
    assert find_line(text, "none")[0] == "2"
    assert find_line(text, "both radii alike")[3] == "2", "the scale of turns"
    assert find_line(text, "radius slip", "radius") == ["slip missed", "1"]
    assert find_line(text, "ticks")[-2:] == ["1", "1"]


# --- explore, homes


def test_images_are_compared_in_one_room_and_what_was_said_with_the_truth():
    said = {"unseen": 0.004, "unseen_low": 0.001, "unseen_high": 0.01, "unseen_true": 0.006}

    def drive(headings: str, room: int, images: int, until: float | None = None) -> Row:
        return make_row(1.0) | {HEADINGS: headings, SEED: room, UNTIL: until, "images_needed": images, **said}

    rooms = [drive(name, room, room * count) for room in (1, 2) for name, count in (("map", 300), ("explore", 600))]
    rows = compare_with_explore([*rooms, drive("map", 1, 250, 0.005), drive("map", 3, 900, 0.005)], [])
    assert [row["over_explore"] for row in rows] == [0.5, 1.0, 0.5, 1.0, None, None]
    assert [row["holds"] for row in rows] == [None] * 4 + [True] * 2
    assert rows[-1]["apart"] == pytest.approx(0.002)
