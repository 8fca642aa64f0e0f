"""The smoother: the filter run forward and backward over a drive, and both states of each time fused.

Fraser and Potter, "The optimum linear smoother as a combination of two optimum linear filters", IEEE Transactions on
Automatic Control 14(4), 1969; here for a few hypotheses on either side.
"""

from collections.abc import Sequence

import numpy as np

from deepgps.tracking.filter import MOST_BY_REFUSED, MOST_EVIDENCE, State, advance, begin, limit, see
from deepgps.tracking.fix import Fix
from deepgps.tracking.motion import SCALE_STD, Motion, invert
from sim.geometry import wrap

AGREEMENT = MOST_EVIDENCE
"""Evidence of two states that agree, against one of them alone."""
PRIOR = np.diag([0.0, 0.0, 0.0, SCALE_STD**-2])


def run_forward(motions: Sequence[Motion | None], fixes: Sequence[Fix | None]) -> list[State]:
    """The state after each of M images.

    Args:
        motions: Motion to each image from the one before (M,); None: nothing is known of it. The first is not used.
        fixes: What each image says (M,); None: nothing.
    """
    states, state = [], begin()
    for motion, fix in zip([None, *motions[1:]], fixes, strict=True):
        state = advance(state, motion, fix)
        states.append(state)
    return states


def run_backward(motions: Sequence[Motion | None], fixes: Sequence[Fix | None]) -> list[State]:
    """The state at each of M images by those after it alone; arguments as of ``run_forward``."""
    states, state = [], begin()
    for motion, fix in zip([None, *reversed(motions[1:])], reversed(fixes), strict=True):
        state = advance(state, motion and invert(motion), None)
        states.append(state)
        if fix is not None and fix.usable:
            state = see(state, fix)
    return states[::-1]


def smooth(causal: Sequence[State], motions: Sequence[Motion | None], fixes: Sequence[Fix | None]) -> list[State]:
    """The state at each of M images by all of them.

    Args:
        causal: The states by the images until then, of ``run_forward``.
        motions: As for ``run_forward``.
        fixes: As for ``run_forward``.
    """
    return [fuse(*both) for both in zip(causal, run_backward(motions, fixes), strict=True)]


def fuse(forward: State, backward: State) -> State:
    """Hypotheses by both states of one time: every pair that agrees, and those of one state alone."""
    if not len(backward.mean):
        return forward
    if not len(forward.mean):
        return backward
    one, other = (part.ravel() for part in np.indices((len(forward.mean), len(backward.mean))))
    mean, covariance, squared = _combine(forward, one, backward, other)
    agreed = forward.evidence[one] + backward.evidence[other] + AGREEMENT - 0.5 * squared
    unsure = np.maximum(forward.evidence[one], backward.evidence[other]) <= MOST_BY_REFUSED
    evidence = np.concatenate([forward.evidence, backward.evidence, limit(agreed, unsure)])
    return State(
        np.concatenate([forward.mean, backward.mean, mean]),
        np.concatenate([forward.covariance, backward.covariance, covariance]),
        evidence,
        forward.trail,
    )


def _combine(
    forward: State, one: np.ndarray, backward: State, other: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hypotheses ``one`` and ``other`` (P,) combined (P, 4), their covariances (P, 4, 4), and how they disagree (P,).

    Both know of the scale what holds before any image, which counts once.
    """
    gap = backward.mean[other] - forward.mean[one]
    gap[:, 2] = wrap(gap[:, 2])
    known = np.linalg.inv(forward.covariance)[one], np.linalg.inv(backward.covariance)[other]
    covariance = np.linalg.inv(known[0] + known[1] - PRIOR)
    pull = known[1] @ gap[..., None] + PRIOR @ forward.mean[one][..., None]
    mean = forward.mean[one] + (covariance @ pull)[..., 0]
    spread = (forward.covariance[one] + backward.covariance[other])[:, :3, :3]
    squared = np.einsum("ki,ki->k", gap[:, :3], np.linalg.solve(spread, gap[:, :3, None])[..., 0])
    return mean, covariance, squared
