"""Figures of what a method accepts: laws that they keep, and the same figures by other code from the file alone."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.evaluation import measures
from deepgps.evaluation.error_field import ErrorField, find_worst, read_all_headings, split_by_acceptance, write_fields
from deepgps.evaluation.measures import (
    MIN_IMAGES,
    REFUSED_SHARES,
    find_risk,
    measure_auroc,
    summarise,
    summarise_acceptance,
)
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


def flatten(values: dict) -> dict[str, float | None]:
    """Figures with those of the table by row."""
    table = values.pop("risk_coverage")
    return values | {f"{name}[{row}]": one for name, column in table.items() for row, one in enumerate(column)}


@given(FIELDS, st.floats(-np.pi, np.pi), st.booleans())
def test_a_rigid_motion_changes_no_figure(field: ErrorField, angle: float, mirrored: bool) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    motion = Alignment(turn @ np.diag([1.0, -1.0 if mirrored else 1.0]), np.array([3.0, -2.0]), 1.0)
    moved = replace(field, truth=motion.apply(field.truth), predicted=motion.apply(field.predicted))
    before, after = flatten(summarise_acceptance(field)), flatten(summarise_acceptance(moved))
    assert before.keys() == after.keys()
    for name, value in before.items():
        assert after[name] == (None if value is None else pytest.approx(value, rel=1e-6, abs=1e-9)), name


@given(FIELDS)
def test_refusing_nothing_gives_the_figures_of_all(field: ErrorField) -> None:
    figures = summarise_acceptance(replace(field, accepted=np.ones_like(field.accepted)))
    assert figures["accepted"] == figures["accepted_places"] == 1.0
    for name, value in summarise(field.worst).items():
        assert figures[f"{name.removesuffix('_m')}_accepted_m"] == value
    assert figures["risk_coverage"]["refused"][0] == 0.0
    assert figures["risk_coverage"]["max_m"][0] == field.error.max()
    assert figures["risk_coverage"]["rms_m"][0] == pytest.approx(np.sqrt((field.error**2).mean()))


@given(FIELDS, st.integers(0, 2**32 - 1))
def test_refusing_the_largest_errors_bounds_every_other_score(field: ErrorField, seed: int) -> None:
    best = find_risk(field.error, field.error)
    assert (np.diff(best) >= -1e-12).all()
    assert field.novelty is not None
    for score in (field.novelty, np.random.default_rng(seed).random(field.error.shape), -field.error):
        risk = find_risk(field.error, score)
        assert (risk >= best - 1e-12).all() and risk[-1] == pytest.approx(best[-1])
    figures = summarise_acceptance(field)
    assert figures["best_aurc_m"] <= figures["aurc_m"]


@given(FIELDS)
def test_only_the_order_of_novelties_matters(field: ErrorField) -> None:
    assert field.novelty is not None
    stretched = replace(field, novelty=np.log(field.novelty) * 7.0 - 3.0)
    assert flatten(summarise_acceptance(stretched)) == flatten(summarise_acceptance(field))


def test_the_figures_are_those_that_other_code_counts_from_the_file(tmp_path: Path) -> None:
    field = make_field(np.random.default_rng(3))
    write_fields(tmp_path / "error_field.npz", {"mine": field})
    figures, data = summarise_acceptance(field), np.load(tmp_path / "error_field.npz")
    errors, novelties, worst, within = [], [], [], {"radius": [], "radius_95": []}
    for place in range(len(data["truth"])):
        accepted_here = []
        for heading in range(len(data["heading"])):
            errors.append(float(np.hypot(*(data["mine"][place, heading] - data["truth"][place]))))
            novelties.append(float(data["novelty/mine"][place, heading]))
            if data["accepted/mine"][place, heading]:
                accepted_here.append(errors[-1])
                for name, counted in within.items():
                    counted.append(errors[-1] <= data[f"{name}/mine"][place, heading])
        worst += [max(accepted_here)] if accepted_here else []
    assert figures["accepted"] == len(within["radius"]) / len(errors)
    assert figures["accepted_places"] == len(worst) / len(data["truth"])
    assert figures["rms_accepted_m"] == pytest.approx(np.sqrt(np.mean(np.square(worst))))
    assert figures["median_accepted_m"] == pytest.approx(np.median(worst))
    assert figures["p95_accepted_m"] == pytest.approx(np.percentile(worst, 95))
    assert figures["max_accepted_m"] == pytest.approx(max(worst))
    assert figures["radius_68_holds"] == pytest.approx(np.mean(within["radius"]))
    assert figures["radius_95_holds"] == pytest.approx(np.mean(within["radius_95"]))
    for row, share in enumerate(REFUSED_SHARES):
        left = [error for _, error in sorted(zip(novelties, errors, strict=True))][: round((1 - share) * len(errors))]
        table = {name: column[row] for name, column in figures["risk_coverage"].items()}
        assert table["rms_m"] == pytest.approx(np.sqrt(np.mean(np.square(left))))
        assert table["max_m"] == pytest.approx(max(left))
    pairs = [(one > other) + 0.5 * (one == other) for one, other in product(*split_by_size(errors, novelties))]
    assert figures["auroc_10cm"] == pytest.approx(np.mean(pairs))
    assert 0.8 < figures["auroc_10cm"] < 1.0


def split_by_size(errors: list[float], novelties: list[float]) -> tuple[list[float], list[float]]:
    """Novelties of errors above 10 cm, and of the others."""
    both = list(zip(errors, novelties, strict=True))
    return [one for error, one in both if error > 0.1], [one for error, one in both if error <= 0.1]


def test_an_unknown_novelty_is_the_highest() -> None:
    error = np.repeat([0.01, 0.5], MIN_IMAGES).reshape(2, MIN_IMAGES)
    score = np.where(error > 0.1, np.nan, 3.0)
    assert measure_auroc(error, score) == 1.0
    assert find_risk(error, score)[MIN_IMAGES - 1] == pytest.approx(0.01)


def test_no_auroc_is_given_for_too_few_large_or_small_errors() -> None:
    for large in (MIN_IMAGES - 1, 100 - MIN_IMAGES + 1):
        error = np.where(np.arange(100) < large, 0.2, 0.01)[:, None]
        assert measure_auroc(error, error) is None


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
