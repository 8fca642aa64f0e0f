"""Figures of what a method accepts: laws that they keep, and the same figures by other code from the file alone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.evaluation import measures
from deepgps.evaluation.error_field import ErrorField, find_worst, read_all_headings, split_by_acceptance, write_fields
from deepgps.evaluation.measures import summarise, summarise_acceptance
from deepgps.positioner.pose import Poses
from sim.alignment import Alignment

FIELDS = st.builds(
    lambda seed, cells, headings: make_field(np.random.default_rng(seed), cells, headings),
    st.integers(0, 2**32 - 1),
    st.integers(1, 40),
    st.integers(1, 4),
)


def make_field(rng: np.random.Generator, cells: int = 200, headings: int = 4) -> ErrorField:
    """Errors of 1 cm, some of 50 cm, with a novelty that tells them more or less, and radii of the right order."""
    truth, size = rng.uniform(0, 4, (cells, 2)), np.where(rng.random((cells, headings)) < 0.1, 0.5, 0.01)
    predicted = truth[:, None] + size[..., None] * rng.standard_normal((cells, headings, 2))
    novelty = size * np.exp(rng.standard_normal(size.shape))
    return ErrorField(
        truth,
        np.arange(headings) * 2 * np.pi / headings,
        predicted,
        novelty=novelty,
        radius=1.5 * novelty,
        radius_95=2.5 * novelty,
        accepted=novelty < 0.1,
    )


@given(FIELDS, st.floats(-np.pi, np.pi), st.booleans())
def test_a_rigid_motion_changes_no_figure(field: ErrorField, angle: float, mirrored: bool) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    motion = Alignment(turn @ np.diag([1.0, -1.0 if mirrored else 1.0]), np.array([3.0, -2.0]), 1.0)
    moved = replace(field, truth=motion.apply(field.truth), predicted=motion.apply(field.predicted))
    before, after = summarise_acceptance(field), summarise_acceptance(moved)
    assert before.keys() == after.keys()
    for name, value in before.items():
        assert after[name] == (None if value is None else pytest.approx(value, rel=1e-6, abs=1e-9)), name


@given(FIELDS)
def test_refusing_nothing_gives_the_figures_of_all(field: ErrorField) -> None:
    figures = summarise_acceptance(replace(field, accepted=np.ones_like(field.accepted)))
    assert figures["accepted"] == figures["accepted_places"] == 1.0
    for name, value in summarise(field.worst).items():
        assert figures[f"{name.removesuffix('_m')}_accepted_m"] == value


def test_the_figures_are_those_that_other_code_counts_from_the_file(tmp_path: Path) -> None:
    field = make_field(np.random.default_rng(3))
    write_fields(tmp_path / "error_field.npz", {"mine": field})
    figures, data = summarise_acceptance(field), np.load(tmp_path / "error_field.npz")
    images, worst, within = 0, [], {"radius": [], "radius_95": []}
    for place in range(len(data["truth"])):
        accepted_here = []
        for heading in range(len(data["heading"])):
            error, images = float(np.hypot(*(data["mine"][place, heading] - data["truth"][place]))), images + 1
            if data["accepted/mine"][place, heading]:
                accepted_here.append(error)
                for name, counted in within.items():
                    counted.append(error <= data[f"{name}/mine"][place, heading])
        worst += [max(accepted_here)] if accepted_here else []
    assert figures["accepted"] == len(within["radius"]) / images
    assert figures["accepted_places"] == len(worst) / len(data["truth"])
    assert figures["rms_accepted_m"] == pytest.approx(np.sqrt(np.mean(np.square(worst))))
    assert figures["median_accepted_m"] == pytest.approx(np.median(worst))
    assert figures["p95_accepted_m"] == pytest.approx(np.percentile(worst, 95))
    assert figures["max_accepted_m"] == pytest.approx(max(worst))
    assert figures["radius_68_holds"] == pytest.approx(np.mean(within["radius"]))
    assert figures["radius_95_holds"] == pytest.approx(np.mean(within["radius_95"]))


def test_a_method_that_accepts_nothing_has_no_figure_of_what_it_accepts() -> None:
    field = make_field(np.random.default_rng(0))
    figures = summarise_acceptance(replace(field, accepted=np.zeros_like(field.accepted)))
    assert figures["accepted"] == figures["accepted_places"] == 0.0
    assert figures["rms_accepted_m"] is None and figures["radius_68_holds"] is None
    json.dumps(figures, allow_nan=False)


def test_what_poses_tell_is_ordered_as_the_test_images_are_and_a_method_that_tells_nothing_has_no_figures() -> None:
    numbers, true = np.arange(12.0), np.zeros((4, 3, 3))
    true[3, 1, 0] = np.nan
    covariance = (1.0 + numbers[:, None, None]) * np.diag([4.0, 1.0])
    parts = {"novelty": numbers, "radius_68": numbers + 1, "radius_95": numbers + 2, "accepted": numbers < 5}
    poses = Poses(np.zeros((12, 2)), **parts, covariance=covariance, reason=numbers)
    told = measures.make_field(poses, true, Alignment(np.array([[0.6, -0.8], [0.8, 0.6]]), np.zeros(2), 1.0))
    assert told.covariance is not None and told.reason is not None and told.reason[1, 2] == 5
    np.testing.assert_allclose(told.covariance[1, 2] @ [0.6, 0.8], 6.0 * 4.0 * np.array([0.6, 0.8]), rtol=1e-6)
    assert len(told.truth) == 3 and told.yaw is None
    for part, value in ((told.novelty, 5.0), (told.radius, 6.0), (told.radius_95, 7.0), (told.accepted, False)):
        assert part is not None and part[1, 2] == value
    silent = ErrorField(told.truth, told.heading, told.predicted)
    assert summarise_acceptance(silent) == {} and silent.is_accepted.all()


def test_what_was_accepted_reads_back_and_old_files_tell_nothing(tmp_path: Path) -> None:
    field = make_field(np.random.default_rng(1))
    old = ErrorField(field.truth, field.heading, field.predicted)
    write_fields(tmp_path / "error_field.npz", {"new": field, "old": old})
    read = read_all_headings(tmp_path)
    for part in ("novelty", "radius", "radius_95", "accepted", "covariance", "reason"):
        np.testing.assert_array_equal(getattr(read["new"], part), getattr(field, part))
        assert getattr(read["old"], part) is None
    assert read["new"].accepted is not None and read["new"].accepted.dtype == bool


@settings(max_examples=30)
@given(FIELDS)
def test_every_position_has_its_worst_accepted_or_its_worst_refused_image(field: ErrorField) -> None:
    taken, refused = split_by_acceptance(field)
    assert field.accepted is not None
    assert len(taken.error) == field.accepted.any(axis=1).sum()
    assert len(refused.error) == (~field.accepted).any(axis=1).sum()
    worst = {tuple(place): 0.0 for place in field.truth}
    for part in (taken, refused):
        np.testing.assert_allclose(part.error, np.linalg.norm(part.predicted - part.truth, axis=1))
        for place, error in zip(part.truth, part.error, strict=True):
            worst[tuple(place)] = max(worst[tuple(place)], error)
    np.testing.assert_allclose(list(worst.values()), find_worst(field).error)
    assert taken.radius is not None and (taken.radius < 1.5 * 0.1).all()
