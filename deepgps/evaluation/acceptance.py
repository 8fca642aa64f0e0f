"""What a positioner says of its own errors, against the truth: which images it accepts, and how large its radii are.

The risk-coverage curve is the RMS error of the images that are left when those with the highest novelty are refused,
over the share refused. Sorting by the true error gives a curve that no score can be below.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import rankdata

from deepgps.evaluation.error_field import ErrorField, find_rms, find_worst
from deepgps.positioner.pose import Poses

PARTS = {"novelty": "novelty", "radius": "radius_68", "radius_95": "radius_95", "accepted": "accepted"}
"""Arrays of an error field, and where poses have them."""
LARGE_M = 0.1
LEAST = 20
"""Errors above ``LARGE_M`` should be refused; with fewer images than this above or below it, no AUROC is given."""
REFUSED = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)
"""Shares of images refused in the table of the risk-coverage curve."""


def take_acceptance(poses: Poses, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """What poses of C * H images say of their errors, as the parts of an error field of this shape (C, H)."""
    found = {name: getattr(poses, source) for name, source in PARTS.items()}
    return {name: np.reshape(part, shape) for name, part in found.items() if part is not None}


def summarise(error: np.ndarray) -> dict[str, float]:
    """RMS, median, 75th and 95th percentile and maximum of errors (C,) [m]."""
    median, p75, p95 = (float(value) for value in np.percentile(error, [50, 75, 95]))
    return {"rms_m": find_rms(error), "median_m": median, "p75_m": p75, "p95_m": p95, "max_m": float(error.max())}


def summarise_acceptance(field: ErrorField) -> dict[str, Any]:
    """What a method accepts, the errors of that, and how well its novelty and its radii tell errors.

    Args:
        field: The method's error field.

    Returns:
        Figures for ``metrics.json``; those of parts that the method does not give are left out. A figure is None where
        there are too few images to compute it from.
    """
    return {**_judge_accepted(field), **_judge_radii(field), **_judge_novelty(field)}


def _judge_accepted(field: ErrorField) -> dict[str, Any]:
    """Shares of images and places accepted, and errors of the places, each at its worst heading of those accepted."""
    if field.accepted is None:
        return {}
    error = find_worst(field, field.accepted).error
    figures = summarise(error) if len(error) else dict.fromkeys(summarise(np.zeros(1)))
    return {
        "accepted": float(field.accepted.mean()),
        "accepted_places": len(error) / max(len(field.truth), 1),
        **{f"{name.removesuffix('_m')}_accepted_m": value for name, value in figures.items()},
    }


def _judge_radii(field: ErrorField) -> dict[str, Any]:
    """Share of the accepted images whose error is within each radius, and the median of the smaller radius [m]."""
    if field.radius is None or field.radius_95 is None:
        return {}
    chosen = field.is_accepted
    median = float(np.median(field.radius[chosen])) if chosen.any() else np.nan
    return {
        "radius_68_holds": _share_within(field.error[chosen], field.radius[chosen]),
        "radius_95_holds": _share_within(field.error[chosen], field.radius_95[chosen]),
        "radius_68_median_m": median if np.isfinite(median) else None,
    }


def _share_within(error: np.ndarray, radius: np.ndarray) -> float | None:
    return float((error <= radius).mean()) if len(error) else None


def _judge_novelty(field: ErrorField) -> dict[str, Any]:
    """How well the novelty ranks the errors of images."""
    if field.novelty is None:
        return {}
    risk, best = find_risk(field.error, field.novelty), find_risk(field.error, field.error)
    largest = np.maximum.accumulate(sort_by(field.novelty, field.error))
    kept = [len(risk) - round(share * len(risk)) - 1 for share in REFUSED]
    return {
        "auroc_10cm": measure_auroc(field.error, field.novelty),
        "aurc_m": float(risk.mean()),
        "best_aurc_m": float(best.mean()),
        "risk_coverage": {
            "refused": list(REFUSED),
            "rms_m": _pick(risk, kept),
            "max_m": _pick(largest, kept),
            "best_rms_m": _pick(best, kept),
        },
    }


def _pick(values: np.ndarray, rows: Sequence[int]) -> list[float]:
    return [float(values[row]) for row in rows]


def find_risk(error: np.ndarray, score: np.ndarray) -> np.ndarray:
    """RMS error [m] of the k images with the lowest scores, for k from 1 to all (n,).

    The mean of this curve is the area under it (AURC; Geifman, Uziel, El-Yaniv, "Bias-Reduced Uncertainty Estimation
    for Deep Neural Classifiers", ICLR 2019, with the RMS error as risk).

    Args:
        error: Errors of the images, of any shape [m].
        score: What the images are ranked by, of the same shape; NaN counts as the highest.
    """
    squared = np.cumsum(sort_by(score, error) ** 2)
    return np.sqrt(squared / np.arange(1, len(squared) + 1))


def sort_by(score: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n,) by increasing score, from arrays of one shape; NaN counts as the highest score."""
    return values.ravel()[np.argsort(score, axis=None, kind="stable")]


def measure_auroc(error: np.ndarray, score: np.ndarray) -> float | None:
    """Probability that an error above ``LARGE_M`` has a higher score than one below it; None with too few of either.

    It is the statistic of Mann and Whitney (Ann. Math. Stat. 18, 1947) over the number of pairs.
    """
    large = error.ravel() > LARGE_M
    above, below = int(large.sum()), int((~large).sum())
    if min(above, below) < LEAST:
        return None
    rank = rankdata(np.where(np.isnan(score), np.inf, score).ravel())
    return float((rank[large].sum() - above * (above + 1) / 2) / (above * below))
