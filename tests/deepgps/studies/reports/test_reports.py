"""What reports do with rows that the published tables do not have: no base, no test grid, nothing accepted."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import NetworkSettings
from deepgps.evaluation.error_field import read_fields
from deepgps.evaluation.measures import measure_visible
from deepgps.learning.networks import make_network
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.reports.plots import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.reports import changes, compare, maps, rooms
from deepgps.studies.reports.columns import ACCEPTED
from deepgps.studies.reports.report import load, varied_names, write_report
from deepgps.studies.study import load_study
from deepgps.studies.table import Row, choices, read_rows, shorten
from sim.files import STUDIES
from sim.recording.format import open_truth

RESULTS = STUDIES.parents[1] / "docs" / "results"
REPORTS_OF = {"precision": rooms.report, "strategies": compare.report, "seeds": compare.report_runs}
ERRORS = {"rms_m": 1.0, "median_m": 0.5, "p95_m": 2.0, "max_m": 10.0}
FAULTS = ["image_faults.exposure", "deployment.light", "seed"]


def read_published(study: str) -> tuple[list[Row], list[str]]:
    return read_rows(RESULTS / study / "table.parquet"), varied_names(load_study(study, tiny=False))


def split_cells(text: str) -> list[list[str]]:
    """The cells of all lines of tables."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]


def cells(text: str, *first: str) -> list[str]:
    """The other cells of the one line that begins with these."""
    (line,) = [line for line in split_cells(text) if tuple(line[: len(first)]) == first]
    return line[len(first) :]


def make_row(rms: float, method: str = "deepgps", **columns: object) -> Row:
    found = None if method == "posenet" else False
    errors = {name: rms * share for name, share in ERRORS.items()}
    return {"method": method, "seed": 0, "flipped": 0.0, "fold_found": found, **errors, **columns}


# --- what is accepted


@pytest.mark.parametrize("study", REPORTS_OF)
def test_what_is_accepted_adds_columns_and_changes_no_other(study: str) -> None:
    rows, varied = read_published(study)
    without = [{name: value for name, value in row.items() if name not in ACCEPTED} for row in rows]
    told = [
        {**row, "rms_accepted_m": row["rms_m"] / 2, "max_accepted_m": row["max_m"] / 3, "accepted": 0.98}
        for row in without
    ]
    before, after = (split_cells(REPORTS_OF[study](some, varied)[0]) for some in (without, told))
    new = [after[0].index(heading) for heading in ACCEPTED.values()]
    assert [[cell for place, cell in enumerate(line) if place not in new] for line in after[2:]] == before[2:]
    rms = after[0].index("RMS [cm]")
    for line in after[2:]:
        assert float(line[new[0]]) == pytest.approx(float(line[rms]) / 2, abs=0.06, rel=0.01)
        assert line[new[2]] == "98.0 %"


def test_targets_of_what_is_accepted_are_medians_over_the_rooms_that_have_them() -> None:
    rows = [row for row in read_published("precision")[0] if row["method"] == "deepgps"]
    held = [0.5 + 0.01 * number for number in range(len(rows))]
    told = [{**row, "radius_68_holds": share, "rms_accepted_m": share} for row, share in zip(rows, held, strict=True)]
    told[-1] |= {"radius_68_holds": None, "radius_95_holds": None}
    figures = rooms.measure([{**row, "max_accepted_m": None} for row in told])
    assert figures["radius_68_holds"].value == pytest.approx(np.median(held[:-1]))
    assert figures["radius_68_holds"].worst == held[0]
    assert figures["rms_accepted_m"].worst == held[-1]
    assert "max_accepted_m" not in figures


# --- no test grid


@pytest.mark.parametrize("name", ["precision", "seeds", "strategies", "networks", "mds", "camera"])
def test_maps_without_a_test_grid_are_neither_folded_nor_not(name: str) -> None:
    study, (rows, varied) = load_study(name, tiny=False), read_published(name)
    rows = [{**row, "flipped": None} for row in rows]
    lines = split_cells(load(REPORTS[study.report].text)(rows, varied)[0])
    (place, *_) = [lines[0].index(word) for word in ("flipped", "folded", "unfolded") if word in lines[0]]
    assert {line[place] for line in lines[2:]} == {"-"}


# --- comparisons

COMMON = {"samples": 100, "train_s": 10.0, "heading_spread_m": 0.004}
FOLLOWS = ["learn.start", "learn.train.segments", "learn.train.samples"]
VARIED = ["drive.strategy", "drive.samples", *FOLLOWS, "room.seed", "seed"]


def driven(strategy: str, samples: int, rms: float, distance: float, room: int, method: str = "deepgps") -> Row:
    choice = {"drive.strategy": strategy, "drive.samples": samples, "room.seed": room}
    choice |= dict(zip(FOLLOWS, ("paths", 16, 16) if strategy == "dense" else ("ends", 128, 2), strict=True))
    return make_row(rms, method, **COMMON, distance_m=distance, **choice)


STRATEGIES = [
    driven("dense", 1500, 0.02, 100.0, 0),
    driven("dense", 1500, 0.04, 120.0, 20),
    driven("dense", 1500, 0.01, 100.0, 0, "posenet"),
    driven("endpoint", 80, 0.90, 105.0, 0) | {"flipped": 0.3, "fold_found": True},
    driven("endpoint", 80, 0.60, 115.0, 20) | {"flipped": 0.2},
    driven("endpoint", 1500, 0.06, 2200.0, 0),
]


def test_rooms_and_seeds_repeat_and_all_else_is_compared() -> None:
    text = "\n".join(compare.report(STRATEGIES, VARIED))
    dense = cells(text, "dense", "1500", "DeepGPS")
    assert dense == ["2", "100", "110", "3.0", "1.5", "6.0", "30.0", "4.0", "0.4", "0", "0", "10"]
    assert cells(text, "endpoint", "80", "DeepGPS")[-3:-1] == ["2", "1"]
    assert cells(text, "dense", "1500", "PoseNet")[-3:-1] == ["0", "-"]
    assert "learn.start paths (dense), ends (endpoint); learn.train.segments 16 (dense), 128 (endpoint)" in text


def test_what_follows_from_another_choice_is_no_choice_and_short_names_are_never_the_same() -> None:
    assert choices(STRATEGIES, VARIED) == ["drive.strategy", "drive.samples"]
    assert choices(STRATEGIES, ["learn.start", *VARIED]) == ["learn.start", "drive.samples"]
    assert shorten(["drive.samples", "learn.train.samples", "learn.start"]) == [
        *("drive.samples", "train.samples", "start")
    ]


def test_strategies_are_compared_at_equal_travel_and_at_equal_images() -> None:
    values = {name: figure.value for name, figure in compare.measure_strategies(STRATEGIES).items()}
    assert values == pytest.approx({"travel_ratio": 25.0, "samples_ratio": 2.0, "way_ratio": 20.0})


def test_networks_are_judged_as_they_train_with_shifted_images() -> None:
    def network(name: str, rms: float, turn: float = 0.0, shift: bool = True) -> Row:
        return make_row(rms, turn_spread_m=turn, **{compare.NETWORK: name, compare.SHIFT: shift})

    rows = [network("invariant", 0.03, 2e-6), network("resnet_paper", 0.06, 0.02)]
    rows += [network("resnet_plain", 0.12, 0.05), network("resnet_plain", 0.90, 0.5, shift=False)]
    values = {name: figure.value for name, figure in compare.measure_networks(rows).items()}
    assert set(values) <= set(REPORTS["networks"].targets)
    assert (values["plain_ratio"], values["plain_turned"]) == pytest.approx((2.0, 2.5))
    assert (values["resnet_plain"], values["invariant_turned"]) == pytest.approx((0.12, 2e-6))


@pytest.mark.parametrize(("architecture", "sees"), [("invariant", False), ("resnet", True), ("resnet_plain", True)])
def test_only_the_invariant_network_does_not_see_a_turn(architecture: str, sees: bool) -> None:
    settings = NetworkSettings.model_validate({"architecture": architecture, "channels": 8})
    network = make_network(settings, 0, 2, torch.Generator().manual_seed(0)).eval()
    positioner = NetworkPositioner((8, 32, 3), None, settings, network, torch.zeros(2), torch.eye(2))
    images = np.random.default_rng(0).integers(0, 256, (3, 8, 32, 3), dtype=np.uint8)
    spread = compare.measure_turn_spread(positioner, images)
    assert spread > 1e-3 if sees else spread < 1e-5


# --- rooms


def test_targets_are_met_or_missed_by_the_mean_of_the_rooms() -> None:
    study = load_study("precision", tiny=False)
    common = {"train_s": 80.0, "relative_rms": 0.01, "seen": 1.0, "failure": None, "median_m": 0.007, "max_m": 0.3}
    rows = [
        make_row(rms, method, run=str(room), recording=str(room), **common, **dict.fromkeys(varied_names(study), room))
        for room, errors in enumerate(((0.01, 0.02), (0.03, 0.02)))
        for method, rms in zip(("deepgps", "posenet"), errors, strict=True)
    ]
    text = write_report(study, [], {}, rows)
    assert cells(text, "RMS") == ["2.0 cm", "-", "3.0 cm", "<= 2.0 cm", "met", "10.1 cm"]
    assert cells(text, "max")[:5] == ["30.0 cm", "-", "30.0 cm", "<= 20.0 cm", "missed"]
    assert cells(text, "RMS / PoseNet's RMS")[:5] == ["1.00", "-", "1.50", "<= 1.05", "met"]
    assert cells(text, "rooms with RMS below PoseNet's")[0] == "50.0 %"
    assert "Of 2 rooms, DeepGPS has lower errors than PoseNet in 1 by RMS (p = 1), 0 by median (p = 1)" in text


def test_wrong_maps_are_counted_by_what_is_said_of_them() -> None:
    own = {"misplaced": 0.02, "undecided": None, "turned": 0.0, rooms.NOISE: 0.0}
    noisy = {**own, "misplaced": 0.6, rooms.NOISE: 0.3}
    rows = [
        make_row(0.3, "deepgps_compass", recording="0", **own),
        make_row(0.2, "posenet", recording="0", **{**own, "misplaced": None}),
        make_row(2.0, "deepgps_compass", recording="1", **{**noisy, "undecided": True}),
        make_row(2.0, "deepgps_compass", recording="2", **{**noisy, "undecided": False}),
        make_row(2.0, recording="0", **{**own, "misplaced": 0.4}) | {"fold_found": True},
        make_row(0.3, recording="1", **{**own, "turned": 0.1}) | {"fold_found": True},
    ]
    rows = [{**row, "seen": 0.9} for row in rows]
    assert split_cells(rooms.report_corridors(rows, [rooms.NOISE])[-1])[2:] == [
        ["0", "DeepGPS, compass", "1", "0", "0", "0", "-", "0", "0"],
        ["0", "DeepGPS", "2", "1", "2", "1", "-", "0", "1"],
        ["0.3", "DeepGPS, compass", "2", "2", "0", "0", "1", "1", "0"],
    ]
    figures = rooms.measure_corridors(rows)
    assert (figures["compass_rms_ratio"].value, figures["compass_unsaid"].value) == (pytest.approx(1.5), 1)
    assert set(rooms.measure_corridors([{**rows[1], "method": "knn"}])) == {"aliased_rms_m"}


# --- faults and changes


def make_fault(rms: float, exposure: float = 1.0, light: float = 1.0, **columns: object) -> Row:
    return make_row(rms, **{"image_faults.exposure": exposure, "deployment.light": light}, **columns)  # pyright: ignore


FAULTY = [make_fault(0.04, light=0.5), make_fault(0.02), make_fault(0.03, exposure=0.25), make_fault(0.05, 0.25)]


def test_each_fault_stands_beside_none_and_those_in_use_alone_come_last() -> None:
    table = changes.report(FAULTY, FAULTS)[0]
    assert cells(table, "no fault", "training and deployment", "DeepGPS")[:2] == ["1", "2.0 (1.00)"]
    assert cells(table, "exposure x 0.25", "training and deployment", "DeepGPS")[:2] == ["2", "4.0 (2.00)"]
    assert [fault.in_use for fault in changes.group_faults(FAULTY, FAULTS)] == [False, False, True]
    values = {name: figure.value for name, figure in changes.measure(FAULTY).items()}
    assert values["clean_rms_m"] == 0.02
    assert (values["both_rms_ratio"], values["deployment_median_ratio"]) == pytest.approx((2.0, 2.0))


def test_without_a_run_without_faults_there_is_nothing_to_compare_with() -> None:
    assert changes.measure(FAULTY[:1]) == {}
    assert cells(changes.report(FAULTY[:1], FAULTS)[0], "all light x 0.5", "deployment only", "DeepGPS")[1] == "4.0"


def test_a_leaning_camera_with_another_fault_does_not_count_as_one_that_leans() -> None:
    lean = "camera_mount.roll_deg"
    rows = [
        make_fault(rms, exposure, method="deepgps_compass", **{lean: degrees})
        for rms, exposure, degrees in ((0.01, 1.0, 0.0), (0.02, 1.0, 8.0), (0.50, 0.25, 8.0), (0.50, 0.25, 2.0))
    ]
    values = {name: figure.value for name, figure in changes.measure(rows).items()}
    assert values == pytest.approx({"compass_tilted_8_ratio": 2.0})


def test_a_study_of_changes_on_one_kind_of_features_needs_not_vary_it(tmp_path: Path) -> None:
    common = {"method": "deepgps_compass", changes.LIGHT: False}
    rows = [
        make_row(0.01, **common, **{"deployment.light": 1.0}),  # pyright: ignore
        make_row(0.02, **common, **{"deployment.light": 0.2}),  # pyright: ignore
    ]
    varied = ["deployment.light", changes.LIGHT]
    assert changes.report_changes(rows, varied)[0] == "## Trained in one light"
    assert changes.measure_changes(rows)["light_0.2_ratio"].value == pytest.approx(2.0)
    assert changes.measure_changes(rows[1:]) == {}
    assert to_png(changes.draw_changes(rows, varied, tmp_path)).startswith(b"\x89PNG")


# --- maps


def test_methods_without_a_map_by_compass_are_left_out(tmp_path: Path) -> None:
    rows, varied = read_published("maps")
    rows = rows[:8]
    other = {**rows[0], **{name: None for name in rows[0] if name.startswith("map_")}}
    assert maps.report([*rows, other], varied) == maps.report(rows, varied)
    assert maps.measure([*rows, other]) == maps.measure(rows)
    assert to_png(maps.draw([other], varied, tmp_path)).startswith(b"\x89PNG")


def reaching(method: str, shape: str, little: float, rest: float) -> Row:
    """10 positions that reach little of the room, 90 that reach much, and the error of each [m]."""
    errors = {f"errors_{part}_m": {0: [little] * 10, 4: [rest] * 90}.get(part, []) for part in range(maps.BINS)}
    return {"method": method, "room.shape": shape, **errors}


def test_errors_by_reach_are_those_of_all_positions_put_together() -> None:
    rows = [reaching("deepgps", "l", 0.3, 0.1), reaching("deepgps", "u", 0.2, 0.1)]
    assert sorted(maps.pool(rows)) == pytest.approx([0.1] * 180 + [0.2] * 10 + [0.3] * 10)
    assert maps.pool(rows, [0]).tolist() == [0.3] * 10 + [0.2] * 10
    assert maps.pool(rows, [2]).tolist() == []


def test_what_little_reach_costs_is_told_for_each_method_where_there_is_any() -> None:
    rows = [reaching("deepgps", "rectangle", 0.4, 0.01), reaching("deepgps", "two_rooms", 0.4, 0.02)]
    figures = maps.measure_concave([*rows, reaching("posenet", "rectangle", 0.01, 0.01)])
    assert figures["deepgps_little"].value == pytest.approx(0.4 / np.sqrt((0.02**2 + 0.01**2) / 2))
    assert figures["posenet_little"].value == pytest.approx(1.0)
    assert "posenet_two_rooms" not in figures
    assert maps.measure_concave([rows[0] | {"errors_0_m": []}])["deepgps_little"].value is None


def test_the_columns_of_reach_hold_every_position(finished_run: Path) -> None:
    row = maps.add_reach(finished_run, {"method": "deepgps"})
    field = read_fields(finished_run)["deepgps"]
    np.testing.assert_allclose(sorted(maps.pool([row])), sorted(field.error), rtol=1e-6)
    visible = measure_visible(open_truth(finished_run / "recording").free_space, field.truth)
    assert len(row["errors_5_m"]) == (visible >= 0.5).sum()
