"""The filter: a few hypotheses of the robot's pose, each with a Kalman filter of its own.

Every image moves the hypotheses, and begins new ones where none is near it. Evidence decides between them: the
likelihood of the images under each, against that of a robot whose pose is unknown. So a robot that was carried is found
again, and places that look alike are told apart while it drives on. Images close together share their errors, so an
image counts only as far as the robot has moved since the last one. Where nothing is mapped, images are of no place that
is known, but may well look like one: there the robot follows its wheels, and an image counts little.

Several hypotheses: Cox and Leonard, "Modeling a dynamic environment using a Bayesian multiple hypothesis approach",
Artificial Intelligence 66(2), 1994.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from deepgps.tracking.fix import Fix, Trail, add_image, begin_trail, break_off, extend, find_factor, update
from deepgps.tracking.motion import SCALE_STD, Motion, invert, move
from sim.geometry import wrap

MAX_HYPOTHESES = 12  # Most hypotheses that are kept
MAX_EVIDENCE = 4.0  # Largest evidence of one image: more would trust the model of its errors too far
MAX_REFUSED_EVIDENCE = 4.0
"""Largest evidence of a hypothesis by images that their method refuses, so that they alone never make one certain."""
MAX_LEAD = 30.0  # Largest evidence of a hypothesis, so that it can be overtaken: the robot may be carried at any time
SHARED_ERROR_M, SHARED_ERROR_RAD = 0.1, 0.2
"""Images of places or headings that are closer share their errors of position and yaw [m], [rad]."""
EVIDENCE_DISTANCE_M = 0.25  # Way after which an image is as much evidence as one of a place far away [m]
MAPPED_DISTANCE_M, UNMAPPED_SHARE = 0.3, 0.1
"""Distance from images of the map up to which a place is mapped [m]; share of the evidence that counts elsewhere."""
REFUSED_ERROR_FACTOR = 4.0  # Factor of the errors of images that their method refuses: they are alike over a long way
MIN_START_GAP_M, MIN_START_GAP_RAD = 0.3, 0.35  # No hypothesis begins so near to another one [m], [rad]
MERGE_M, MERGE_RAD = 0.05, 0.1
"""Of two hypotheses that have come so near to each other the likelier one is kept [m], [rad]."""
FAN = 8  # Headings at which hypotheses begin where an image tells no yaw
ACCEPTANCE_PROBABILITY = 0.999  # Probability from which an estimate is accepted


@dataclass(frozen=True)
class State:
    """What the filter knows."""

    mean: np.ndarray  # Hypotheses of the pose x, y [m], yaw [rad], and of the error of the odometry's scale (K, 4)
    covariance: np.ndarray  # Their covariances (K, 4, 4)
    evidence: np.ndarray  # Log-likelihood of the images under each, against a robot whose pose is unknown (K,)
    trail: Trail  # The last images along the path by odometry, which tell how large the errors of images are
    moved_m: float = np.inf  # Way since the last image that was used [m]
    turned_rad: float = np.inf  # Turns since then [rad]
    mapped: KDTree | None = None  # Places of the images of the map [m]; None: unknown


@dataclass(frozen=True)
class Estimate:
    """The likeliest pose."""

    position: np.ndarray  # Position (2,) [m]; NaN before the first image
    position_std: float  # Its standard deviation along each axis [m]
    yaw: float  # Yaw [rad]
    yaw_std: float  # Its standard deviation [rad]
    probability: (
        float  # That the robot is near it (``MIN_START_GAP_M``), and neither at another hypothesis nor elsewhere
    )
    accepted: bool  # Whether it is certain enough to be used


def begin(mapped: KDTree | None = None) -> State:
    """The state of a robot whose pose is unknown, on a map of images at these places [m] if they are known."""
    return State(np.empty((0, 4)), np.empty((0, 4, 4)), np.empty(0), begin_trail(), mapped=mapped)


def advance(state: State, motion: Motion | None, fix: Fix | None) -> State:
    """The state after a motion, None if nothing is known of it, as before the first image, and an image, if any."""
    return see(predict(state, motion), fix)


def predict(state: State, motion: Motion | None) -> State:
    """The state after a motion; None: nothing is known of it."""
    if motion is None:
        return replace(begin(state.mapped), trail=break_off(state.trail))
    mean, covariance = move(state.mean, state.covariance, motion)
    scale = float(mean[state.evidence.argmax(), 3]) if len(mean) else 0.0
    return replace(
        state,
        mean=mean,
        covariance=covariance,
        trail=extend(state.trail, motion, 1.0 + scale),
        moved_m=state.moved_m + motion.expected_m,
        turned_rad=state.turned_rad + motion.expected_rad,
    )


def see(state: State, fix: Fix | None) -> State:
    """The state after an image; None, or one that is not usable: the same."""
    if fix is None or not fix.usable:
        return state
    trail = add_image(state.trail, fix)
    fix = _scale(fix, find_factor(trail) * (1.0 if fix.accepted else REFUSED_ERROR_FACTOR))
    moved, counts = state.moved_m / SHARED_ERROR_M, _find_share(state) * min(1.0, state.moved_m / EVIDENCE_DISTANCE_M)
    own_place, own_yaw = np.sqrt(np.clip([moved, moved + state.turned_rad / SHARED_ERROR_RAD], 1e-6, 1.0)).tolist()
    updated = update(state.mean, state.covariance, _scale(fix, 1.0 / own_place, 1.0 / own_yaw))
    evidence = state.evidence + counts * np.minimum(updated.likelihood, MAX_EVIDENCE)
    if not fix.accepted:  # what was certain does not rise, and nothing becomes so
        certain = state.evidence > MAX_REFUSED_EVIDENCE
        evidence = np.where(certain, np.minimum(evidence, state.evidence), limit(evidence, ~certain))
    state = State(updated.mean, updated.covariance, evidence, trail, 0.0, 0.0, state.mapped)
    return _keep_best(_add_new(state, fix))


def estimate(state: State) -> Estimate:
    """The likeliest hypothesis of a state."""
    if not len(state.mean):
        return Estimate(np.full(2, np.nan), np.inf, np.nan, np.inf, 0.0, False)
    best = int(state.evidence.argmax())
    near = _find_near(state.mean[best : best + 1], state.mean, MIN_START_GAP_M, MIN_START_GAP_RAD)[0]
    probability = float(weigh(state)[near].sum())
    mean, variance = state.mean[best], np.diagonal(state.covariance[best])
    return Estimate(
        mean[:2],
        float(np.sqrt(variance[:2].mean())),
        float(wrap(mean[2])),
        float(np.sqrt(variance[2])),
        probability,
        probability >= ACCEPTANCE_PROBABILITY,
    )


def weigh(state: State) -> np.ndarray:
    """Probability of each hypothesis (K,), among all of them and a pose that is none of these."""
    highest = max(0.0, float(state.evidence.max(initial=0.0)))
    likelihood = np.exp(state.evidence - highest)
    return likelihood / (likelihood.sum() + np.exp(-highest))


def limit(evidence: np.ndarray, unsure: np.ndarray) -> np.ndarray:
    """Evidence (K,), where ``unsure`` (K,) lowered alike, so that none of it exceeds ``MAX_REFUSED_EVIDENCE``."""
    excess = max(float(evidence[unsure].max(initial=0.0)) - MAX_REFUSED_EVIDENCE, 0.0)
    return evidence - np.where(unsure, excess, 0.0)


def _find_share(state: State) -> float:
    """How much an image counts, by where the robot probably is."""
    best = int(state.evidence.argmax()) if len(state.evidence) else None
    if state.mapped is None or best is None or weigh(state)[best] < 0.5:
        return 1.0
    return 1.0 if state.mapped.query(state.mean[best, :2])[0] <= MAPPED_DISTANCE_M else UNMAPPED_SHARE


def _scale(fix: Fix, place: float, yaw: float = 1.0) -> Fix:
    """An image with standard deviations so many times as large."""
    others = tuple(_scale(one, place, yaw) for one in fix.others)
    return replace(fix, position_std=place * fix.position_std, yaw_std=yaw * fix.yaw_std, others=others)


def _add_new(state: State, fix: Fix) -> State:
    """The state with hypotheses at the image's own poses, where none is near."""
    poses = [fix, *fix.others]
    if not np.isfinite(fix.yaw):
        turned = [replace(one, yaw=2.0 * np.pi * number / FAN) for one in poses for number in range(FAN)]
        poses = [replace(one, yaw_std=np.pi / FAN, weight=one.weight / FAN) for one in turned]
    mean = np.array([[*one.position, wrap(np.array(one.yaw)), 0.0] for one in poses])
    new = ~_find_near(mean, state.mean, MIN_START_GAP_M, MIN_START_GAP_RAD).any(axis=1)
    spread = np.array([[one.position_std, one.position_std, one.yaw_std, SCALE_STD] for one in poses])
    weight = np.array([one.weight for one in poses])
    return replace(
        state,
        mean=np.concatenate([state.mean, mean[new]]),
        covariance=np.concatenate([state.covariance, (np.eye(4) * spread[:, None] ** 2)[new]]),
        evidence=np.concatenate([state.evidence, np.log(weight[new])]),
    )


def _keep_best(state: State) -> State:
    """The likeliest hypotheses, the first with at most the evidence ``MAX_LEAD``.

    Doubles are left out, and those that are less likely than an unknown pose.
    """
    order = np.argsort(-state.evidence, kind="stable")
    mean, evidence = state.mean[order], state.evidence[order]
    double = np.tril(_find_near(mean, mean, MERGE_M, MERGE_RAD), -1).any(axis=1)
    hopeless = evidence < -MAX_EVIDENCE
    hopeless[0] = False
    kept = order[~double & ~hopeless][:MAX_HYPOTHESES]
    evidence = state.evidence[kept]
    return replace(
        state,
        mean=state.mean[kept],
        covariance=state.covariance[kept],
        evidence=evidence - max(float(evidence[0]) - MAX_LEAD, 0.0),
    )


def _find_near(one: np.ndarray, other: np.ndarray, near_m: float, near_rad: float) -> np.ndarray:
    """Which of hypotheses (K, 4) and (J, 4) are near to each other (K, J) bool."""
    away = one[:, None] - other
    return (np.hypot(away[..., 0], away[..., 1]) < near_m) & (np.abs(wrap(away[..., 2])) < near_rad)


AGREEMENT = MAX_EVIDENCE  # Evidence of two states that agree, against one of them alone
PRIOR = np.diag([0.0, 0.0, 0.0, SCALE_STD**-2])


def run_forward(
    motions: Sequence[Motion | None], fixes: Sequence[Fix | None], mapped: KDTree | None = None
) -> list[State]:
    """The state after each of M images, by the motions to each from the one before, the first of which is not used.

    The map is of images at the places ``mapped``, if they are known.
    """
    return [after for _, after in _run(motions[1:], fixes, mapped)]


def run_backward(
    motions: Sequence[Motion | None], fixes: Sequence[Fix | None], mapped: KDTree | None = None
) -> list[State]:
    """The state at each of M images by those after it alone; arguments as of ``run_forward``."""
    back = [motion and invert(motion) for motion in reversed(motions[1:])]
    return [before for before, _ in _run(back, fixes[::-1], mapped)][::-1]


def _run(
    motions: Sequence[Motion | None], fixes: Sequence[Fix | None], mapped: KDTree | None
) -> list[tuple[State, State]]:
    """The states before and after each of M images with M - 1 motions between them."""
    states, after = [], begin(mapped)
    for motion, fix in zip([None, *motions], fixes, strict=True):
        before = predict(after, motion)
        after = see(before, fix)
        states.append((before, after))
    return states


def smooth(causal: Sequence[State], motions: Sequence[Motion | None], fixes: Sequence[Fix | None]) -> list[State]:
    """The state at each of M images by all of them, given those by the images until then; else as ``run_forward``."""
    backward = run_backward(motions, fixes, causal[0].mapped if causal else None)
    return [fuse(*both) for both in zip(causal, backward, strict=True)]


def fuse(forward: State, backward: State) -> State:
    """Hypotheses by both states of one time: every pair that agrees, and those of one state alone."""
    if not len(backward.mean):
        return forward
    if not len(forward.mean):
        return backward
    one, other = (part.ravel() for part in np.indices((len(forward.mean), len(backward.mean))))
    mean, covariance, squared = _combine(forward, one, backward, other)
    agreed = forward.evidence[one] + backward.evidence[other] + AGREEMENT - 0.5 * squared
    unsure = np.maximum(forward.evidence[one], backward.evidence[other]) <= MAX_REFUSED_EVIDENCE
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
