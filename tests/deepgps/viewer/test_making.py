"""The tab of the initial map: every stage is there, with all loop closures, and ellipses of the right size."""

from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest
import rerun as rr

from deepgps.initial_map.stored_map import FILE, StoredMap
from deepgps.runs.run_folder import VIEWED
from deepgps.viewer.making import MAP_ENTITY, MAX_ELLIPSES, MIN_HALF_AXIS_M, SIGMAS, enlarge
from deepgps.viewer.run import write_run
from deepgps.viewer.stream import MAP_STAGE as TIMELINE
from sim.files.checksums import read_arrays, write_arrays
from tests.helpers.blueprints import find_missing, read_entity, read_layout
from tests.helpers.synthetic_run import write_synthetic_run

SAMPLES, STAGES, CLOSURES = 60, 3, 20


def make_map(pose: np.ndarray, rng: np.random.Generator) -> StoredMap:
    """A map that straightens: a third of the loop closures are inliers at its second stage, two thirds at its last."""
    count = len(pose)
    drift = np.linspace(1.0, 0.0, STAGES)[:, None, None] * np.linspace(0.0, 0.5, count)[None, :, None]
    places = pose[:, :2] @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + [4.0, 1.0]
    inliers = np.arange(CLOSURES) % 3 < np.arange(STAGES)[:, None]
    turn = np.flatnonzero(np.abs(np.diff(pose[:, 2])) > 0)
    return StoredMap(
        places=places,
        heading=pose[:, 2],
        covariance=np.tile(np.diag([0.01, 0.04]) ** 2, (count, 1, 1)),
        samples=np.array(32),
        undecided=np.arange(count) > 0.8 * count,
        closure=rng.integers(0, count, (CLOSURES, 2)),
        closure_turn=np.where(np.arange(CLOSURES) % 2, 0.5, np.nan),
        turn=np.stack([turn, turn + 1], axis=1),
        turn_angle=np.diff(pose[:, 2])[turn],
        turn_std=np.full(len(turn), 0.01),
        stage=np.array([0, 1, 5]),
        stage_places=(places + drift).astype(np.float32),
        stage_heading=np.tile(pose[:, 2], (STAGES, 1)).astype(np.float32),
        stage_believed=inliers,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_synthetic_run(tmp_path_factory.mktemp("run"), samples=SAMPLES, spacing_m=0.4)
    pose = np.load(folder / "recording" / "truth" / "pose.npy")
    write_arrays(folder / "deepgps" / FILE, vars(make_map(pose, np.random.default_rng(0))))
    fields = read_arrays(folder / "error_field.npz")
    write_arrays(folder / "error_field.npz", {**fields, "expected/deepgps": np.full(len(fields["truth"]), 0.02)})
    rr.set_strict_mode(True)
    write_run(folder)
    rr.set_strict_mode(False)
    return folder


def read_stages(run: Path, name: str) -> list[list]:
    rows = read_entity(run / VIEWED, f"{MAP_ENTITY}/{name}")
    rows = rows.filter(pc.field(TIMELINE).is_valid()).sort_by(TIMELINE)
    return [one for one in rows["LineStrips3D:strips"].to_pylist() if one is not None]


def test_each_loop_closure_is_an_inlier_or_refused_at_each_stage(run: Path):
    inliers, refused = ([len(stage) for stage in read_stages(run, name)] for name in ("inliers", "refused"))
    assert inliers == [0, 7, 14] and [sum(pair) for pair in zip(inliers, refused, strict=True)] == [CLOSURES] * STAGES


def test_the_last_stage_is_where_the_robot_was_and_the_first_is_not(run: Path):
    pose = np.load(run / "recording" / "truth" / "pose.npy")
    off = []
    for stage in read_stages(run, "path"):
        points = np.array([point[:2] for strip in stage for point in strip])
        off.append(np.linalg.norm(points[:, None] - pose[None, :, :2], axis=2).min(axis=1).max())
    assert off[-1] < 1e-5 and off[0] > 0.05


def test_a_turn_has_its_angle_to_point_at(run: Path):
    rows = read_entity(run / VIEWED, f"{MAP_ENTITY}/turns")
    said = [text for texts in rows["turned"].to_pylist() if texts for text in texts]
    assert said and all("°" in text and "± 0.57°" in text for text in said)


def test_every_view_of_the_tab_shows_what_was_logged(run: Path):
    assert find_missing(run / VIEWED) == []
    layout = read_layout(run / VIEWED, "ViewBlueprint:space_origin")
    origins = [origin.strip("/") for _, found in layout for origin in found]
    assert "making" in origins


@pytest.mark.parametrize("std_m", [1e-5, 0.003, 0.02, 0.5])
def test_ellipses_are_as_large_as_can_be_seen_and_never_smaller_than_they_are(std_m: float):
    stored = make_map(np.zeros((MAX_ELLIPSES, 3)), np.random.default_rng(0))
    larger = enlarge(StoredMap(**{**vars(stored), "covariance": np.tile(std_m**2 * np.eye(2), (MAX_ELLIPSES, 1, 1))}))
    assert larger >= 1.0
    assert larger == 1.0 or larger * SIGMAS * std_m <= MIN_HALF_AXIS_M * 1.001
    assert larger > 1000.0 or larger * SIGMAS * std_m > 0.39 * MIN_HALF_AXIS_M
