"""Which loop closures of a map are inliers, what the rejected ones say about it, and how they join parts of a drive.

Between parts the robot was carried or its turn is unknown. A loop closure with its relative heading shows how one part
is placed against the other. A join needs several that agree in place and heading, and no other group of them that
agrees on something else.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from deepgps.data.segments import measure_spacing
from deepgps.initial_map.compass.bars import Bars, turn
from sim.geometry import wrap

GATE = 4.0  # Standard deviations within which a loop closure is an inlier
KNOWN_GATE_M, VAGUE_GATE_M, MAX_GATE_M = 0.3, 0.5, 2.0
"""A gate below ``KNOWN_GATE_M`` means that the distance of the two observations is known; above ``VAGUE_GATE_M`` they
only look alike. No gate is wider than ``MAX_GATE_M`` [m]."""
REPEAT_SHARE, MIN_KNOWN_CLOSURES = 0.02, 20
"""The world repeats after a distance d if at least ``MIN_KNOWN_CLOSURES`` closures have a known distance, and
``REPEAT_SHARE`` of these only look alike and are no more than d apart."""
LOOK_STD, LOOK_STD_PER_M = 0.22, 0.62
"""Standard deviation of a loop closure: in one place, in steps between readings, and per metre between its ends."""
ROBUST_SCALE = 3.0  # Standard deviations at which a loop closure has lost three quarters of its weight
HEADING_STD_RAD, HEADING_STD_RAD_PER_M, MAX_HEADING_DIFFERENCE_RAD = np.radians(0.2), np.radians(13.0), 0.35
"""Standard deviation of a loop closure's relative heading in one place, and for each metre between its ends. A closure
whose heading differs from the map's by more than ``MAX_HEADING_DIFFERENCE_RAD`` is false."""
MIN_CLOSURES, MIN_INLIER_SHARE = 4, 0.5
"""A segment is doubted if it has at least ``MIN_CLOSURES`` loop closures and less than ``MIN_INLIER_SHARE`` of these
are inliers."""
MIN_CROSSING_CLOSURES, MAX_CROSSING_INLIER_SHARE = 10, 0.1
"""A turn is wrong if at least ``MIN_CROSSING_CLOSURES`` loop closures connect what was driven before and after it, and
no more than ``MAX_CROSSING_INLIER_SHARE`` of these are inliers."""


@dataclass(frozen=True)
class Closures:
    """Loop closures: images of almost one place."""

    first: np.ndarray  # First observation of each (n,)
    second: np.ndarray  # Second (n,)
    length: np.ndarray  # Estimated distance between them (n,) [m]
    turn: np.ndarray  # Angle from the first's heading to the second's, to the left (n,) [rad]; NaN: open


class Links(NamedTuple):
    """Loop closures between readings of bars."""

    number: np.ndarray  # Number of each in ``Closures`` (m,)
    one: np.ndarray  # First reading (m,)
    other: np.ndarray  # Second reading (m,)
    variance: np.ndarray  # Expected square of their distance along each axis (m,) [m^2]
    turn: np.ndarray  # Angle from the first's heading to the second's (m,) [rad]; NaN: open
    turn_std: np.ndarray  # Its standard deviation (m,) [rad]


class Inliers(NamedTuple):
    """Which loop closures are inliers, with the weights of their squared residuals."""

    mask: np.ndarray  # Whether each is an inlier (m,) bool
    place: np.ndarray  # Weight of its position (m,)
    turn: np.ndarray  # Weight of its relative heading (m,)
    repeats_m: float  # Distance after which the world repeats [m]; infinite: it does not repeat; 0: unknown


def link(bars: Bars, closures: Closures, observations: int) -> Links:
    """Loop closures between the bars' readings; those without a reading are left out."""
    reading = bars.find_readings(observations)
    one, other = reading[closures.first], reading[closures.second]
    number = np.flatnonzero((one >= 0) & (other >= 0))
    step = measure_spacing(np.diff(bars.along)[np.diff(bars.row) == 0])
    length = closures.length[number]
    return Links(
        number,
        one[number],
        other[number],
        (LOOK_STD * step) ** 2
        + (LOOK_STD_PER_M * length) ** 2
        + (bars.uneven_m2[one[number]] + bars.uneven_m2[other[number]]) / 2.0,
        closures.turn[number],
        np.hypot(HEADING_STD_RAD, HEADING_STD_RAD_PER_M * length),
    )


def find_inliers(bars: Bars, error: np.ndarray, part: np.ndarray, links: Links, narrow: bool) -> Inliers:
    """The loop closures within the gate, if the gate is narrower than half of where the world repeats.

    Samples of the errors of readings' positions are (r, 2, k) [m]. Between parts of the drive, as bars (B,) have them,
    none is an inlier. ``narrow``: only gates below ``KNOWN_GATE_M`` count, which need not know after what distance the
    world repeats.
    """
    _, heading, _, point = bars.locate(slice(None))
    squared = ((point[links.one] - point[links.other]) ** 2).sum(axis=1)
    known = ((error[links.one] - error[links.other]) ** 2).mean(axis=2).sum(axis=1) / 2.0
    away = np.nan_to_num(wrap(heading[links.other] - heading[links.one] - links.turn))
    possible = (part[bars.row[links.one]] == part[bars.row[links.other]]) & (np.abs(away) < MAX_HEADING_DIFFERENCE_RAD)
    gate = GATE * np.sqrt(2.0 * known)
    sure = np.concatenate([np.sqrt(squared[possible & (gate < KNOWN_GATE_M)]), _measure_twins(error, point, links)])
    repeats_m = _find_repeat(sure)
    reach = KNOWN_GATE_M if narrow else limit_gate(repeats_m)
    mask = possible & (gate < reach) & (squared < 2.0 * GATE**2 * (known + links.variance))
    place = (1.0 + squared / (2.0 * ROBUST_SCALE**2 * links.variance)) ** -2.0
    return Inliers(mask, place, (1.0 + (away / (ROBUST_SCALE * links.turn_std)) ** 2) ** -2.0, repeats_m)


def limit_gate(repeats_m: float) -> float:
    """Width of the widest gate [m]: half of the distance after which the world repeats."""
    return float(np.clip(repeats_m / 2.0, KNOWN_GATE_M, MAX_GATE_M))


def _measure_twins(error: np.ndarray, point: np.ndarray, links: Links) -> np.ndarray:
    """Distances (k,) [m] between two readings that both look like a third, where these distances are known well."""
    of, end = np.concatenate([links.one, links.other]), np.concatenate([links.other, links.one])
    order = np.argsort(of, kind="stable")
    same = np.diff(of[order]) == 0
    first, second = end[order][:-1][same], end[order][1:][same]
    known = ((error[first] - error[second]) ** 2).mean(axis=2).sum(axis=1)
    sure = GATE * np.sqrt(known) < KNOWN_GATE_M
    return np.linalg.norm(point[first[sure]] - point[second[sure]], axis=1)


def _find_repeat(apart: np.ndarray) -> float:
    """Distance [m] after which the world repeats, from well-known distances (k,) between look-alikes; 0: unknown."""
    if len(apart) < MIN_KNOWN_CLOSURES:
        return 0.0
    far = np.sort(apart[apart > VAGUE_GATE_M])
    few = int(np.ceil(REPEAT_SHARE * len(apart)))
    return float(far[few]) if len(far) > few else np.inf


def find_parts(bars: Bars, links: Links, cut: np.ndarray, inliers: Inliers) -> np.ndarray:
    """Part of the drive of each bar (B,): joints that are not ``cut`` (B - 1,) and closures connect it."""
    joint = np.flatnonzero(~cut)
    one = np.concatenate([joint, bars.row[links.one[inliers.mask]]])
    other = np.concatenate([joint + 1, bars.row[links.other[inliers.mask]]])
    size = len(bars.unknown)
    graph = csr_array((np.ones(len(one)), (one, other)), shape=(size, size))
    return np.asarray(connected_components(graph, directed=False)[1])


def find_contradicted(bars: Bars, part: np.ndarray, links: Links, inliers: Inliers) -> np.ndarray:
    """Joints (B - 1,) bool at whose turn something is wrong: of the loop closures across it hardly any is an inlier."""
    low, high = np.sort([bars.row[links.one], bars.row[links.other]], axis=0)
    same = part[low] == part[high]

    def count(chosen: np.ndarray) -> np.ndarray:
        change = np.bincount(low[chosen], minlength=len(part)) - np.bincount(high[chosen], minlength=len(part))
        return np.cumsum(change)[:-1]

    across = count(same)
    return (
        (across >= MIN_CROSSING_CLOSURES)
        & (count(same & inliers.mask) < MAX_CROSSING_INLIER_SHARE * across)
        & (np.diff(bars.segment) > 0)
    )


def find_doubted(bars: Bars, links: Links, inliers: Inliers) -> np.ndarray:
    """Segments (L,) bool whose place most of their loop closures contradict, or that hang on such segments alone."""
    ends = bars.segment[bars.row[np.concatenate([links.one, links.other])]]
    segments = bars.segment[-1] + 1
    count = np.bincount(ends, minlength=segments)
    agreed = np.bincount(ends, np.tile(inliers.mask, 2), segments)
    doubted = (count >= MIN_CLOSURES) & (agreed < MIN_INLIER_SHARE * count)
    pairs = np.concatenate([ends.reshape(2, -1)[:, inliers.mask], np.arange(segments - 1) + [[0], [1]]], axis=1)
    one, other = pairs[:, ~doubted[pairs].any(axis=0)]
    joined = csr_array((np.ones(len(one)), (one, other)), (segments, segments))
    part, readings = connected_components(joined, directed=False)[1], bars.segment[bars.row]
    return part != np.bincount(part[readings], ~doubted[readings]).argmax()


AGREEMENT_M, AGREEMENT_RAD = 0.3, 0.2  # How far loop closures that agree may place a part apart
MIN_AGREEING_CLOSURES = 4  # Loop closures that must agree
MIN_VOTE_RATIO = 2.0  # So many times as many must agree on the best placement as on any other
MAX_TRIED_CLOSURES = 200  # Most loop closures of two parts that are tried as placements


class Placement(NamedTuple):
    """A part placed against another: turned by ``angle`` [rad] about ``middle`` (2,), which comes to ``place``."""

    stays: int  # Number of the part that stays
    moves: int  # Number of the part that is moved
    middle: np.ndarray  # A point of it (2,) [m]
    place: np.ndarray  # Where this point belongs (2,) [m]
    angle: float  # To the left [rad]


def join_parts(bars: Bars, part: np.ndarray, links: Links) -> np.ndarray:
    """Join the two parts with the most agreeing loop closures, and mark these (m,); none: no two can be joined.

    The smaller part is moved to the larger one's frame, in ``bars``, and takes its number in ``part`` (B,).
    """
    one, other = part[bars.row[links.one]], part[bars.row[links.other]]
    across = np.flatnonzero((one != other) & np.isfinite(links.turn))
    best, chosen = np.empty(0, int), None
    low, high = np.minimum(one, other)[across], np.maximum(one, other)[across]
    _, number, count = np.unique(low * (part.max() + 1) + high, return_inverse=True, return_counts=True)
    for pair in np.argsort(-count):
        if count[pair] < max(MIN_AGREEING_CLOSURES, len(best) + 1):
            break
        agreeing, placement = _vote(bars, part, links, across[number == pair])
        if len(agreeing) > len(best):
            best, chosen = agreeing, placement
    marked = np.zeros(len(links.one), bool)
    if chosen is not None:
        marked[best] = True
        _move(bars, part, chosen)
    return marked


def _vote(bars: Bars, part: np.ndarray, links: Links, of: np.ndarray) -> tuple[np.ndarray, Placement | None]:
    """Those of the loop closures ``of`` that agree on one placement, if no other has half as many, and it."""
    numbers, size = np.unique(part[bars.row[np.concatenate([links.one[of], links.other[of]])]]), np.bincount(part)
    stays, moves = sorted(numbers, key=lambda number: -size[number])
    swapped = part[bars.row[links.one[of]]] == moves
    there = np.where(swapped, links.other[of], links.one[of])
    here = np.where(swapped, links.one[of], links.other[of])
    _, heading, _, camera = bars.locate(slice(None))
    angle = heading[there] - heading[here] + np.where(swapped, -links.turn[of], links.turn[of])
    middle = camera[here].mean(axis=0)
    target = camera[there] - turn(angle, camera[here] - middle)  # where each puts the middle
    tried = np.linspace(0, len(of) - 1, min(MAX_TRIED_CLOSURES, len(of))).astype(int)
    agrees = (np.linalg.norm(target[tried, None] - target, axis=2) < AGREEMENT_M) & (
        np.abs(wrap(angle[tried, None] - angle)) < AGREEMENT_RAD
    )
    votes = agrees.sum(axis=1)
    top = votes.argmax()
    rival = ~(
        (np.linalg.norm(target[tried] - target[tried[top]], axis=1) < 2.0 * AGREEMENT_M)
        & (np.abs(wrap(angle[tried] - angle[tried[top]])) < 2.0 * AGREEMENT_RAD)
    )
    if votes[top] < MIN_AGREEING_CLOSURES or votes[top] < MIN_VOTE_RATIO * votes[rival].max(initial=0):
        return np.empty(0, int), None
    inside = agrees[top]
    mean = np.angle(np.exp(1j * angle[inside]).mean())
    place = (camera[there[inside]] - turn(np.full(inside.sum(), mean), camera[here[inside]] - middle)).mean(axis=0)
    return of[inside], Placement(stays, moves, middle, place, float(mean))


def _move(bars: Bars, part: np.ndarray, placement: Placement) -> None:
    moved = part == placement.moves
    away = bars.unknown[moved, :2] - placement.middle
    bars.unknown[moved, :2] = placement.place + turn(np.full(len(away), placement.angle), away)
    bars.unknown[moved, 2] += placement.angle
    part[moved] = placement.stays
