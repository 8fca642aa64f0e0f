"""The reports that compare: groups, means and claims from made-up rows, and one real study, small, to its pictures."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import Architecture, NetworkSettings
from deepgps.learning.networks import make_network
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.studies import grouping
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports import compare, networks, strategies
from deepgps.studies.reports.report import report_study, write_report
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from tests.helpers.small_study import run_all_here

COMMON = {"p95_m": 0.05, "max_m": 0.5, "flipped": 0.0, "train_s": 10.0, "heading_spread_m": 0.004, "fold_found": None}


def make_row(**columns: object) -> Row:
    rms = columns["rms_m"]
    assert isinstance(rms, float)
    return {"samples": 100, "distance_m": 8.0, "median_m": rms / 2, "turn_spread_m": 0.0, **COMMON, **columns}


def cells(text: str, *first: str) -> list[str]:
    """The cells of the one line of a table that begins with these."""
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    (line,) = [line for line in found if tuple(line[: len(first)]) == first]
    return line[len(first) :]


FOLLOWS = ["learn.start", "learn.train.segments", "learn.train.samples"]


def driven(strategy: str, samples: int, rms: float, distance: float, room: int, method: str = "deepgps") -> Row:
    choice = {"drive.strategy": strategy, "drive.samples": samples, "room.seed": room}
    choice |= dict(zip(FOLLOWS, ("paths", 16, 16) if strategy == "dense" else ("ends", 128, 2), strict=True))
    found = {"fold_found": False} if method == "deepgps" else {}
    return make_row(method=method, rms_m=rms, distance_m=distance, samples=samples, seed=0, **choice, **found)


STRATEGIES = [
    driven("dense", 1500, 0.02, 100.0, 0),
    driven("dense", 1500, 0.04, 120.0, 20),
    driven("dense", 1500, 0.01, 100.0, 0, "posenet"),
    driven("endpoint", 80, 0.90, 105.0, 0) | {"flipped": 0.3, "fold_found": True},
    driven("endpoint", 80, 0.60, 115.0, 20) | {"flipped": 0.2},
    driven("endpoint", 1500, 0.06, 2200.0, 0),
]
VARIED = ["drive.strategy", "drive.samples", *FOLLOWS, "room.seed", "seed"]


def test_rooms_and_seeds_repeat_and_all_else_is_compared():
    table = compare.report(STRATEGIES, VARIED)[0]
    dense = cells(table, "dense", "1500", "DeepGPS")
    assert dense == ["2", "1500", "110", "3.0", "1.5", "5.0", "50.0", "4.0", "0.4", "0", "0", "10"]
    assert cells(table, "endpoint", "80", "DeepGPS")[-3:-1] == ["2", "1"]
    assert cells(table, "dense", "1500", "PoseNet")[-3:-1] == ["0", "-"]
    assert len(table.splitlines()) == 2 + 4


def test_what_follows_from_another_choice_is_not_named():
    assert grouping.choices(STRATEGIES, VARIED) == ["drive.strategy", "drive.samples"]
    assert grouping.choices(STRATEGIES, ["learn.start", *VARIED]) == ["learn.start", "drive.samples"]


def test_what_follows_is_told_below_the_table():
    text = "\n".join(compare.report(STRATEGIES, VARIED))
    assert "learn.start paths (dense), ends (endpoint); learn.train.segments 16 (dense), 128 (endpoint)" in text
    assert "Dependent settings" not in "\n".join(compare.report(STRATEGIES, ["drive.strategy", "drive.samples"]))


def test_names_are_short_but_never_the_same():
    assert grouping.shorten(["drive.samples", "learn.train.samples", "learn.start"]) == [
        *("drive.samples", "train.samples", "start")
    ]


def test_strategies_are_compared_at_equal_travel_and_at_equal_images():
    study = load_study("strategies", tiny=False)
    plan, *_ = plan_runs(study)
    text = write_report(study, [plan], {}, [{**row, "run": plan.run, "failure": None} for row in STRATEGIES])
    assert cells(text, "RMS, end-point / dense, equal travel")[:5] == ["25.00", "-", "-", ">= 1.00", "met"]
    assert cells(text, "RMS, end-point / dense, equal images")[0] == "2.00"
    assert cells(text, "travel, end-point / dense, equal images")[0] == "20.00"
    assert set(strategies.measure(STRATEGIES)) == set(REPORTS["strategies"].targets)


def test_the_strategies_study_differs_in_nothing_but_the_strategy_and_gives_batches_of_one_size():
    for plan in plan_runs(load_study("strategies", tiny=False)):
        train = plan.scenario.learn.train
        assert (train.samples == 2) == (plan.scenario.drive.strategy == "endpoint")
        assert train.segments * train.samples == 256


def network_row(name: str, rms: float, shift: bool = True, turn: float = 0.0) -> Row:
    choice = {networks.NETWORK: name, networks.SHIFT: shift}
    return make_row(method="deepgps", rms_m=rms, turn_spread_m=turn, seed=0, **choice)


def test_networks_are_judged_as_they_train_with_shifted_images():
    rows = [
        network_row("spectral", 0.02),
        network_row("invariant", 0.03, turn=2e-6),
        network_row("resnet", 0.05, turn=0.01),
        network_row("resnet_paper", 0.06, turn=0.02),
        network_row("resnet_plain", 0.12, turn=0.05),
        network_row("resnet_plain", 0.90, shift=False, turn=0.5),
    ]
    figures = networks.measure(rows)
    assert set(figures) == set(REPORTS["networks"].targets)
    assert figures["plain_ratio"].value == pytest.approx(2.0)
    assert figures["plain_turned"].value == pytest.approx(2.5)
    assert figures["resnet_plain"].value == pytest.approx(0.12)
    assert figures["invariant_turned"].value == pytest.approx(2e-6)
    text = "\n".join(networks.report(rows, [networks.NETWORK, networks.SHIFT]))
    assert cells(text, "resnet_plain", "False", "DeepGPS")[8:10] == ["0.4", "50"]


@pytest.mark.parametrize(
    ("architecture", "sees"), [("invariant", False), ("resnet", True), ("resnet_paper", True), ("resnet_plain", True)]
)
def test_only_the_invariant_network_does_not_see_a_turn(architecture: Architecture, sees: bool):
    settings = NetworkSettings(architecture=architecture, channels=8)
    network = make_network(settings, 0, 2, torch.Generator().manual_seed(0)).eval()
    positioner = NetworkPositioner((8, 32, 3), None, settings, network, torch.zeros(2), torch.eye(2))
    images = np.random.default_rng(0).integers(0, 256, (3, 8, 32, 3), dtype=np.uint8)
    spread = networks.measure_turn_spread(positioner, images)
    assert spread > 1e-3 if sees else spread < 1e-5


@pytest.mark.slow
def test_the_networks_study_runs_to_its_pictures(tmp_path: Path):
    study = load_study("networks", tiny=True)
    plans = plan_runs(study)
    assert carry_out(study, plans, tmp_path / "study", run_all=run_all_here, progress=ignore) == {}
    text = report_study(study, plans, {}, tmp_path / "study")
    assert float(cells(text, "invariant", "DeepGPS")[-4]) < 0.01
    assert float(cells(text, "resnet_plain", "DeepGPS")[-4]) > 0.01
    assert {path.name for path in tmp_path.glob("study/figures/*")} == {"errors.png", "error_fields.png"}
