"""The study of mds: classical scaling against points whose distances are known, and networks that learned a plane."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from deepgps.config.learning import LearnSettings
from deepgps.methods.fit import fit_method
from deepgps.reports.plots import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.mds import (
    add_distances,
    are_joined,
    draw,
    find_distances,
    measure,
    report,
    scale_all,
)
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.geometry import FreeSpace
from tests.helpers.toy import QUICK, make_toy

VARIED = ["learn.start"]


def test_distances_in_a_plane_give_the_points_back():
    points = np.random.default_rng(0).normal(size=(40, 2)) * (3.0, 1.0)
    place, eigenvalues, planar = scale_all(squareform(pdist(points)))
    assert np.allclose(fit_alignment(place, points, "E2").apply(place), points, atol=1e-9)
    assert planar == pytest.approx(1.0)
    assert np.allclose(eigenvalues[2:], 0.0, atol=1e-9)


def test_distances_in_space_give_the_two_principal_axes():
    points = np.random.default_rng(1).normal(size=(60, 5)) * (4.0, 2.0, 1.0, 0.5, 0.1)
    place, eigenvalues, planar = scale_all(squareform(pdist(points)))
    _, size, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    flat = (points - points.mean(axis=0)) @ axes[:2].T
    assert np.allclose(np.abs(place), np.abs(flat), atol=1e-9)
    assert np.allclose(eigenvalues[:5], size**2)
    assert planar == pytest.approx((size[:2] ** 2).sum() / (size**2).sum())


def test_a_wall_parts_what_no_straight_way_joins():
    reachable = np.ones((11, 11), bool)
    reachable[:8, 5] = False  # a wall from y = 0 to y = 0.7 at x = 0.5
    space = FreeSpace(np.zeros(2), 0.1, reachable, reachable, np.zeros(2), 1.0)
    first = np.array([[0.0, 0.1], [0.0, 0.9], [0.1, 0.1]])
    second = np.array([[1.0, 0.1], [1.0, 0.9], [0.4, 0.6]])
    assert are_joined(space, first, second).tolist() == [False, True, True]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of a study on the plane world of the tests: two outputs, and four that stay four."""
    folder = tmp_path_factory.mktemp("mds")
    ways = {"paths": {"start": "paths"}, "lifting": {"start": "lifting", "lift": {"dimensions": 4, "penalty": 0.0}}}
    for name, way in ways.items():
        recording = make_toy(folder / "runs" / name / "recording")
        settings = LearnSettings.model_validate({**QUICK, **way, "fold": {"restarts": 0}})
        fit_method("deepgps", recording, settings, 0, folder / "runs" / name / "deepgps", ignore)
    fit_method("knn", recording, LearnSettings.model_validate(QUICK), 0, folder / "runs" / "lifting" / "knn", ignore)
    return folder


def test_a_network_of_two_outputs_is_its_own_map(folder: Path):
    found = find_distances(folder / "runs" / "paths", "deepgps")
    assert found.dimensions == 2
    assert found.planar == pytest.approx(1.0)
    assert np.allclose(found.own, found.scaled, atol=1e-6)
    assert np.median(np.linalg.norm(found.own - found.truth, axis=1)) < 0.1
    assert np.allclose(found.true, pdist(found.truth))
    assert np.median(np.abs(found.predicted - found.true)) < 0.1
    assert found.joined.any()
    assert not found.joined.all()


def test_a_network_of_more_outputs_learns_distances_that_nearly_lie_in_a_plane(folder: Path):
    found = find_distances(folder / "runs" / "lifting", "deepgps")
    assert found.dimensions == 4
    assert 0.8 < found.planar < 1.0
    assert np.median(np.linalg.norm(found.scaled - found.truth, axis=1)) < 0.2


def test_the_report_says_how_far_the_map_is_from_the_network_and_draws_it(folder: Path):
    rows = []
    for name in ("paths", "lifting"):
        row = {"run": name, "learn.start": name, "method": "deepgps", "flipped": 0.0, "fold_found": False}
        rows.append({**row, **add_distances(folder / "runs" / name, row)})
    assert rows[0]["mds_own_m"] < 1e-6
    figures = measure(rows)
    assert set(figures) == set(REPORTS["mds"].targets)
    assert figures["planar"].value == rows[1]["planar"]
    assert figures["mds_ratio"].value == pytest.approx(rows[1]["mds_m"] / rows[0]["own_m"])
    text = report(rows, VARIED)[0]
    assert "paths, DeepGPS" in text
    assert to_png(draw(rows, VARIED, folder)).startswith(b"\x89PNG")


def test_a_method_without_a_network_has_no_distances(folder: Path):
    with pytest.raises(InputError, match="knn has no network"):
        find_distances(folder / "runs" / "lifting", "knn")


def test_the_study_asks_with_two_outputs_and_with_more():
    plans = plan_runs(load_study("mds", tiny=False))
    ways = {(plan.scenario.learn.start, plan.scenario.learn.network.layers) for plan in plans}
    assert ways == {(start, layers) for start in ("lifting", "random") for layers in (3, 6)} | {("paths", 3)}
    assert {plan.scenario.learn.lift.penalty for plan in plans} == {0.0}
