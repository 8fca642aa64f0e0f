"""Measures of a map and of a drive: coverage, flipped parts, yaw, acceptance."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from deepgps.evaluation.error_field import ErrorField, find_rms, find_worst
from deepgps.positioner.pose import Poses
from sim.alignment import Alignment

SEEN_RADIUS_M = 0.25
OFF_CENTRE = 0.25
"""Distance from the middle of the room, as a fraction of half its extent, from which a part has a direction."""


def measure_coverage(cells: np.ndarray, samples: np.ndarray) -> dict[str, Any]:
    """Count test positions (C, 2) [m], and those with a training sample (N, 2) [m] near enough to have been seen; name
    the part of the room in which most of the others are."""
    seen = find_seen(cells, samples)
    part = name_part(cells, ~seen)
    return {
        "reachable_cells": len(cells),  # Test positions
        "cells_seen": int(seen.sum()),  # Those within 0.25 m of a training observation
        # The part of the room with most of the others, north along y; left out where they lie all around
        **({"missed": part} if part else {}),
    }


def find_seen(places: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Whether places (C, 2) [m] have a training sample (N, 2) [m] within ``SEEN_RADIUS_M``: (C,)."""
    return KDTree(samples).query(places)[0] <= SEEN_RADIUS_M


def name_part(cells: np.ndarray, chosen: np.ndarray) -> str | None:
    """The part of the room, with north along +y, in which the chosen (C,) of the positions (C, 2) [m] lie on average.

    None if there are none, or if they lie all around the middle.
    """
    if not chosen.any():
        return None
    low, high = cells.min(axis=0), cells.max(axis=0)
    x, y = (cells[chosen].mean(axis=0) - (low + high) / 2) / np.maximum((high - low) / 2, 1e-9)
    north = "north" if y > OFF_CENTRE else "south" if y < -OFF_CENTRE else ""
    east = "east" if x > OFF_CENTRE else "west" if x < -OFF_CENTRE else ""
    return "-".join(filter(None, (north, east))) or None


def measure_flipped(truth: np.ndarray, predicted: np.ndarray, spacing_m: float) -> float:
    """Share of a map that is flipped, as by a fold: 0 for a correct map, at most a half.

    Test positions are on a grid of this spacing, with a prediction for each, both (C, 2) [m]. The share is that of the
    neighbourhoods (a position, its right and its upper neighbour) with the rarer orientation, which no rigid motion or
    reflection of the map changes.
    """
    area = _measure_areas(np.rint((truth - truth.min(axis=0)) / spacing_m).astype(int), predicted)
    area = area[np.isfinite(area)]
    return float(min((area > 0).mean(), (area < 0).mean())) if len(area) else 0.0


def _measure_areas(cell: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Signed areas (columns, rows) of the neighbourhoods of cells (C, 2) that lie at (C, 2) [m]; NaN: incomplete."""
    table = np.full((*(cell.max(axis=0) + 2), 2), np.nan)  # a margin, so that the last cells have missing neighbours
    table[tuple(cell.T)] = place
    right, up = (table[1:, :-1] - table[:-1, :-1], table[:-1, 1:] - table[:-1, :-1])
    return right[..., 0] * up[..., 1] - right[..., 1] * up[..., 0]


def summarise_yaw(field: ErrorField) -> dict[str, float]:
    """RMS, median and 95th percentile of the yaw's error [deg] over all images, and RMS over those accepted.

    Empty where there is no yaw; without the last where the method accepts or refuses nothing.
    """
    if field.yaw_error is None or not (known := np.isfinite(field.yaw_error)).any():
        return {}
    error = np.degrees(np.abs(field.yaw_error))
    median, p95 = (float(value) for value in np.percentile(error[known], [50, 95]))
    figures = {"yaw_rms_deg": find_rms(error[known]), "yaw_median_deg": median, "yaw_p95_deg": p95}
    if field.accepted is not None and (accepted := known & field.accepted).any():
        figures["yaw_rms_accepted_deg"] = find_rms(error[accepted])
    return figures


PARTS = {"novelty": "novelty", "radius": "radius_68", "radius_95": "radius_95", "accepted": "accepted"}
"""Arrays of an error field, and where poses have them."""


def make_field(poses: Poses, true: np.ndarray, alignment: Alignment, with_yaw: bool = True) -> ErrorField:
    """The error field of poses of C * H images in a method's frame, which the alignment takes to that of the truth.

    True poses (C, H, 3) are x, y [m], yaw [rad]; places where they are NaN are left out.
    """
    shape, known = true.shape[:2], np.isfinite(true).all(axis=(1, 2))
    parts = {name: getattr(poses, source) for name, source in PARTS.items()}
    if with_yaw and poses.yaw is not None:
        parts |= {"yaw": alignment.turn(poses.yaw), "yaw_std": poses.yaw_std}
    if poses.covariance is not None and poses.reason is not None:
        turned = alignment.rotation @ poses.covariance @ alignment.rotation.T
        parts |= {"covariance": turned.astype(np.float32), "reason": poses.reason.astype(np.int8)}
    parts = {name: part.reshape(*shape, *part.shape[1:])[known] for name, part in parts.items() if part is not None}
    predicted, pose = alignment.apply(poses.position).reshape(*shape, 2)[known], true[known]
    heading = pose[..., 2]
    shared = (heading[:1] == heading).all()  # a drive reaches each place with a different heading
    return ErrorField(pose[:, 0, :2], heading[0] if shared else heading, predicted, **parts)


def summarise(error: np.ndarray) -> dict[str, float]:
    """RMS, median, 75th and 95th percentile and maximum of errors (C,) [m]."""
    median, p75, p95 = (float(value) for value in np.percentile(error, [50, 75, 95]))
    return {"rms_m": find_rms(error), "median_m": median, "p75_m": p75, "p95_m": p95, "max_m": float(error.max())}


def summarise_acceptance(field: ErrorField) -> dict[str, Any]:
    """Figures of what a method accepts, the errors of that, and how well its radii hold.

    Those of parts that the method does not give are left out.
    """
    return {**_judge_accepted(field), **_judge_radii(field)}


def _judge_accepted(field: ErrorField) -> dict[str, Any]:
    """Shares of images and places accepted, and errors of the places, each at its worst heading of those accepted."""
    if field.accepted is None:
        return {}
    error = find_worst(field, field.accepted).error
    figures = summarise(error) if len(error) else dict.fromkeys(summarise(np.zeros(1)))
    return {
        "accepted": float(field.accepted.mean()),  # Share of the test images that the method accepts
        "accepted_places": len(error) / max(len(field.truth), 1),  # Share of the positions with at least one such image
        **{f"{name.removesuffix('_m')}_accepted_m": value for name, value in figures.items()},
    }


def _judge_radii(field: ErrorField) -> dict[str, Any]:
    """Share of the accepted images whose error is within each radius, and the median of the smaller radius [m]."""
    if field.radius is None or field.radius_95 is None:
        return {}
    chosen = field.is_accepted
    median = float(np.median(field.radius[chosen])) if chosen.any() else np.nan
    return {
        # Share of the accepted images whose error is at most this radius, which should be 68 %
        "radius_68_holds": _share_within(field.error[chosen], field.radius[chosen]),
        "radius_95_holds": _share_within(field.error[chosen], field.radius_95[chosen]),  # The same for 95 %
        # Median of the first radius over the accepted images
        "radius_68_median_m": median if np.isfinite(median) else None,
    }


def _share_within(error: np.ndarray, radius: np.ndarray) -> float | None:
    return float((error <= radius).mean()) if len(error) else None
