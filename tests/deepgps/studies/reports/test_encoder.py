"""The report of encoders from made-up rows, and what the study asks."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.recordings import find_drives
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.encoder import (
    PERFECT,
    add_errors,
    choose_encoders,
    draw,
    draw_near,
    find_pairs,
    find_sweeps,
    measure,
)
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from sim.settings import EncoderSettings

NAMES = (
    *("encoder.ticks_per_rev", "encoder.step_noise", "encoder.radius_error_left", "encoder.radius_error_right"),
    *("encoder.slip_per_m", "encoder.stuck_fraction", "robot.wheel_radius_error"),
)
SHARES = (("deepgps", 1.0), ("deepgps_noise_aware", 0.5))


def make_rows(
    rms: dict[tuple[tuple[str, float], ...], float], shares: tuple[tuple[str, float], ...] = SHARES
) -> list[Row]:
    """Two seeds of the methods for each set of faults; each method has its share of the error."""
    rows = []
    for faults, error in rms.items():
        settings = {name: dict(faults).get(name, PERFECT[name]) for name in NAMES}
        for method, share in shares:
            for seed in (0, 1):
                row = {"run": "r", "seed": seed, **settings, "samples": 100, "method": method, "scale": 1.0}
                row |= {"rms_m": share * error * (1 + 0.1 * seed), "median_m": share * error / 10, "failure": None}
                row |= {"flipped": 0.3 if error > 0.2 else 0.01}
                row |= {"within_2_cm": 1.0 - 10 * share * error, "within_5_cm": 1.0 - 3 * share * error}
                row |= {"segment_rms_m": error, "segment_expected_m": error, "wrong_doubted": 3, "segments_wrong": 4}
                rows.append(row)
    return rows


ROWS = make_rows(
    {
        (): 0.01,
        (("encoder.ticks_per_rev", 64),): 0.0105,
        (("encoder.ticks_per_rev", 16),): 0.011,
        (("encoder.ticks_per_rev", 4),): 0.03,
        (("encoder.step_noise", 0.1),): 0.025,
        (("encoder.radius_error_left", 0.02), ("encoder.radius_error_right", 0.02)): 0.04,
        (("encoder.radius_error_left", 0.02),): 0.02,
        (("encoder.step_noise", 0.1), ("encoder.ticks_per_rev", 4)): 0.05,
    }
)


def test_faults_are_told_apart_from_pairs_of_them():
    found = {sweep.names: list(sweep.by_value("deepgps")) for sweep in find_sweeps(ROWS)}
    assert found == {
        ("encoder.ticks_per_rev",): [4096, 64, 16, 4],
        ("encoder.step_noise",): [0.0, 0.1],
        ("encoder.radius_error_left",): [0.0, 0.02],
        ("encoder.radius_error_left", "encoder.radius_error_right"): [0.0, 0.02],
    }
    assert find_pairs(ROWS) == [("encoder.step_noise", "encoder.ticks_per_rev")]


def test_faults_of_either_sign_grow_from_none():
    sweep = find_sweeps(make_rows({(("encoder.radius_error_left", error),): 0.01 for error in (-0.1, 0.0, 0.02)}))[0]
    assert list(sweep.by_value("deepgps")) == [0.0, 0.02, -0.1]


def test_the_page_says_which_encoder_is_enough():
    methods = ["deepgps", "deepgps_noise_aware"]

    def choose(rows: list[Row], near_m: float) -> dict[str, list[str]]:
        return read_cells(choose_encoders(find_sweeps(rows), methods, near_m))

    enough = choose(ROWS, 0.02)
    assert enough["ticks per revolution"] == ["16", "all, to 4"]
    assert enough["noise w of each gap"] == ["none tolerated", "all, to 0.1"]
    assert choose(ROWS, 0.05)["noise w of each gap"] == ["all, to 0.1", "all, to 0.1"]
    one_bad_place = [{**row, "seed": 2, "rms_m": 1.0} for row in ROWS if row["seed"] == 0]
    assert choose([*ROWS, *one_bad_place], 0.02) == enough
    worse = [{**row, "within_2_cm": row["within_2_cm"] - 0.2} for row in ROWS]
    assert {cell for line in choose(worse, 0.02).values() for cell in line} == {"none is enough"}


def test_places_near_the_truth_are_counted_at_their_worst_heading(tmp_path: Path):
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    predicted = np.stack([truth, truth + np.array([[0.0, 0.01], [0.0, 0.03], [0.04, 0.0], [0.0, 0.3]])], axis=1)
    np.savez(tmp_path / "error_field.npz", truth=truth, heading=np.zeros(2), deepgps=predicted)
    (tmp_path / "metrics.json").write_text('{"methods": {}, "distances": {"segment_rms_m": 0.1}}')
    columns = add_errors(tmp_path, {"method": "deepgps"})
    assert columns == {"within_2_cm": 0.25, "within_5_cm": 0.75, "segment_rms_m": 0.1}


def read_cells(table: str, names: int = 1) -> dict[str, list[str]]:
    """Cells of a Markdown table by its first columns."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("|")]
    return {" ".join(line[:names]): line[names:] for line in lines[2:]}


def test_targets_are_ratios_to_a_perfect_encoder():
    figures = measure(ROWS)
    assert set(figures) == {name for name in REPORTS["encoder"].targets if not name.startswith("compass")}
    assert figures["rms_w"].value == pytest.approx(0.025 * 1.05)
    assert figures["aware_rms_w"].worst == pytest.approx(0.0125 * 1.1)
    assert figures["ticks_16"].value == pytest.approx(1.1)
    assert figures["ticks_4"].value == figures["aware_ticks_4"].value == pytest.approx(3.0)


def test_the_compass_is_judged_beside_distances_alone_when_stuck_and_on_curves():
    faults = {
        **{(): 0.01, (("encoder.step_noise", 0.3),): 0.1, (("encoder.radius_error_left", 0.01),): 0.1},
        **{(("encoder.slip_per_m", 0.1),): 0.1, (("encoder.stuck_fraction", 0.5),): 0.3},
        **{(("robot.wheel_radius_error", 0.01),): 0.011, (("robot.wheel_radius_error", 0.03),): 0.012},
    }
    figures = measure(make_rows(faults, (("deepgps_compass", 0.5), ("deepgps", 1.0))))
    found = {name.removeprefix("compass_"): figure for name, figure in figures.items() if name.startswith("compass")}
    assert {f"compass_{name}" for name in found} <= set(REPORTS["encoder"].targets)
    values = {name: figure.value for name, figure in found.items()}
    assert values == pytest.approx(
        {
            **{"w": 0.5, "radius": 0.5, "slip": 0.5, "stuck_rms_m": 0.15 * 1.05, "stuck_folded": 2},
            **{"curves_1": 1.1, "curves_3": 1.2},
        }
    )
    assert found["stuck_rms_m"].worst == pytest.approx(0.15 * 1.1)


def test_what_its_map_expects_is_drawn_for_a_method_that_knows_it():
    rows = [{**row, "map_expected_rms_m": row["rms_m"] / 2 if row["method"] == "deepgps" else None} for row in ROWS]
    lines = {str(line.get_label()): line for line in draw(rows, [], Path()).axes[0].lines}
    expected, measured = (np.asarray(lines[f"DeepGPS{words}"].get_ydata()) for words in (": expected by its map", ""))
    np.testing.assert_allclose(expected, measured / 2)
    assert not any("noise-aware: expected" in label for label in lines)


def test_the_part_of_the_room_that_stays_near_is_drawn_beside_what_is_good_enough():
    axes = draw_near(ROWS, [], Path()).axes[0]
    assert axes.get_ylim() == (0, 100)
    lines = {str(line.get_label()): np.asarray(line.get_ydata()).tolist() for line in axes.lines}
    assert lines["DeepGPS"] == pytest.approx([90, 89.5, 89, 70])
    assert lines["good enough"] == [80, 80]


def test_the_study_asks_of_every_fault_with_five_seeds_and_shares_five_drives_of_each_robot():
    plans = plan_runs(load_study("encoder", tiny=False))
    asked = {name for plan in plans for name in EncoderSettings.model_fields if name in str(dict(plan.varied))}
    assert asked == set(EncoderSettings.model_fields) - {"plugins"}
    assert len({plan.scenario.seed for plan in plans}) == 5
    robots = {plan.scenario.robot.wheel_radius_error for plan in plans}
    assert len(robots) == 3
    assert len({drive.model_dump_json() for drive in find_drives(plans).values()}) == 5 * len(robots)
    assert {tuple(plan.scenario.methods) for plan in plans} == {
        (
            *("deepgps_compass", "deepgps", "deepgps_noise_aware"),
            *("deepgps_with_turns", "dead_reckoned_labels", "posenet"),
        )
    }
