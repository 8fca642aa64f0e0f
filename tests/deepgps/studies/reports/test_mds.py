"""The study of mds: classical scaling against points whose distances are known, and networks that learned a plane."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from deepgps.config.learning import LearnSettings
from deepgps.methods.fit import fit_method
from deepgps.reports.plots import to_png
from deepgps.studies.reports.mds import add_distances, are_joined, draw, find_distances, scale_all
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


def test_a_network_of_two_outputs_is_its_own_map(finished_run: Path):
    found = find_distances(finished_run, "deepgps")
    assert found.dimensions == 2
    assert found.planar == pytest.approx(1.0)
    assert np.allclose(found.own, found.scaled, atol=1e-5)
    assert np.allclose(found.true, pdist(found.truth))
    columns = add_distances(finished_run, {"method": "deepgps"})
    assert columns["mds_own_m"] < 1e-5 and columns["own_m"] == pytest.approx(columns["mds_m"], abs=1e-5)
    with pytest.raises(InputError, match="knn has no network"):
        find_distances(finished_run, "knn")


@pytest.mark.slow
def test_a_network_of_more_outputs_learns_distances_that_nearly_lie_in_a_plane(tmp_path: Path):
    rows = []
    ways = {"paths": {"start": "paths"}, "lifting": {"start": "lifting", "lift": {"dimensions": 4, "penalty": 0.0}}}
    for name, way in ways.items():
        run = tmp_path / "runs" / name
        settings = LearnSettings.model_validate({**QUICK, **way, "fold": {"restarts": 0}})
        fit_method("deepgps", make_toy(run / "recording"), settings, 0, run / "deepgps", ignore)
        row = {"run": name, "learn.start": name, "method": "deepgps", "flipped": 0.0, "fold_found": False}
        rows.append({**row, **add_distances(run, row)})
    plane, space = (find_distances(tmp_path / "runs" / name, "deepgps") for name in ways)
    assert np.median(np.linalg.norm(plane.own - plane.truth, axis=1)) < 0.1
    assert np.median(np.abs(plane.predicted - plane.true)) < 0.1
    assert plane.joined.any() and not plane.joined.all()
    assert space.dimensions == 4 and 0.8 < space.planar < 1.0
    assert np.median(np.linalg.norm(space.scaled - space.truth, axis=1)) < 0.2
    assert to_png(draw(rows, VARIED, tmp_path)).startswith(b"\x89PNG")
