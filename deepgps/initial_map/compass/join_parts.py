"""Parts of a drive, between which the robot was carried or its turn is unknown, are joined by what they both saw.

A loop closure with its relative heading shows how one part is placed against the other. A join needs several that agree
in place and heading, and no other group of them that agrees on something else.
"""

from typing import NamedTuple

import numpy as np

from deepgps.initial_map.compass.bars import Bars, turn
from deepgps.initial_map.compass.closures import Links
from sim.geometry import wrap

AGREE_M, AGREE_RAD = 0.3, 0.2
"""How far loop closures that agree may place a part apart."""
LEAST = 4
"""Loop closures that must agree."""
CLEAR = 2.0
"""So many times as many must agree on the best placement as on any other."""
MOST = 200
"""Most loop closures of two parts that are tried as placements."""


class Placement(NamedTuple):
    """How a part is placed against another: turned by ``angle`` [rad] about ``middle`` (2,), which comes to ``place``.

    Attributes:
        stays: Number of the part that stays.
        moves: Number of the part that is moved.
        middle: A point of it (2,) [m].
        place: Where this point belongs (2,) [m].
        angle: To the left [rad].
    """

    stays: int
    moves: int
    middle: np.ndarray
    place: np.ndarray
    angle: float


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
        if count[pair] < max(LEAST, len(best) + 1):
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
    tried = np.linspace(0, len(of) - 1, min(MOST, len(of))).astype(int)
    agrees = (np.linalg.norm(target[tried, None] - target, axis=2) < AGREE_M) & (
        np.abs(wrap(angle[tried, None] - angle)) < AGREE_RAD
    )
    votes = agrees.sum(axis=1)
    top = votes.argmax()
    rival = ~(
        (np.linalg.norm(target[tried] - target[tried[top]], axis=1) < 2.0 * AGREE_M)
        & (np.abs(wrap(angle[tried] - angle[tried[top]])) < 2.0 * AGREE_RAD)
    )
    if votes[top] < LEAST or votes[top] < CLEAR * votes[rival].max(initial=0):
        return np.empty(0, int), None
    inside = agrees[top]
    mean = np.angle(np.exp(1j * angle[inside]).mean())
    place = (camera[there[inside]] - turn(np.full(inside.sum(), mean), camera[here[inside]] - middle)).mean(axis=0)
    return of[inside], Placement(stays, moves, middle, place, float(mean))


def _move(bars: Bars, part: np.ndarray, placement: Placement) -> None:
    """Move a part, and give it the number of the part that stays."""
    moved = part == placement.moves
    away = bars.unknown[moved, :2] - placement.middle
    bars.unknown[moved, :2] = placement.place + turn(np.full(len(away), placement.angle), away)
    bars.unknown[moved, 2] += placement.angle
    part[moved] = placement.stays
