"""An initial map by the compass: segments laid end to end along its headings, then refined by loop closures.

The compass gives the differences of headings, the encoders the lengths, so the map can neither fold nor mirror. A loop
closure says that two images were taken in almost one place, and how far the second is turned against the first. It is
an inlier only within a gate: a few standard deviations of the distance between its two ends, from the covariance of the
map itself, so that a place that only looks alike is never joined with one far away.
"""

from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np

from deepgps.data.segments import Segments
from deepgps.data.turns import CompassTurns
from deepgps.initial_map.compass.bars import SHARED_UNKNOWNS, Bars, lay_out
from deepgps.initial_map.compass.closures import (
    GATE,
    Closures,
    Inliers,
    Links,
    find_contradicted,
    find_doubted,
    find_inliers,
    find_parts,
    join_parts,
    limit_gate,
    link,
)
from deepgps.initial_map.compass.factors import Factors, add_factors, even_out, rescale_factors
from deepgps.initial_map.compass.least_squares import (
    SAMPLES,
    Equations,
    Joints,
    Scale,
    add_links,
    add_odometry,
    carry,
    hold_length,
    make_joints,
    rescale,
)

NEIGHBOURS = 3
MAX_ROUNDS, GROWTH_ROUNDS, MIN_GROWTH = 20, 5, 0.1
"""Most rounds after the map has grown. It grows while this part more loop closures are inliers than ``GROWTH_ROUNDS``
rounds before: in a long drive, each drift can be seen only after shorter ones are mended."""
ATTEMPTS = 10  # Times that parts are joined although they have come apart again when refined
CONVERGENCE_M, CONVERGENCE_SHARE = 0.001, 0.001
"""The map is finished once no round moves it further than this [m], or changes this part of the inliers."""
CUT_STD_RAD, CUT_STD_M = 0.15, 0.5
"""A turn, or the distance between two segments, that is known less well cuts the drive into parts."""
RECUTS = 3  # Times that turns which loop closures contradict are cut
UNDERSTATED_RATIO = 1.5  # Where lengths err so many times more than expected, the map is made again with shorter bars
MAX_TURN = 0.5
FACTOR_ROUNDS = 6  # Rounds of a map with the registrations of its images
MAX_STAGES = 8  # Of the map's making, kept: the first rounds move it most, and most of these are kept


@dataclass(frozen=True)
class Stage:
    """The map after one round of its making."""

    places: np.ndarray  # Positions of the camera at the observations (N, 2) [m]; NaN where they are unknown
    heading: np.ndarray  # Heading of the robot at each (N,) [rad]
    inliers: np.ndarray  # Which loop closures are inliers (n,) bool
    number: int  # Rounds before it; 0: as laid out along the compass headings


@dataclass
class Layout:
    """The bars of a map, which a fit moves, and what is known of how they lie."""

    bars: Bars
    laid_out: Bars  # The same before any fit: where along their bars the encoder has the readings
    joints: Joints
    links: Links
    cut: np.ndarray  # Joints at which the drive is cut into parts (B - 1,) bool
    curvature: float  # Of what the robot drives for straight, before the map [1 / m]

    def relate(self, fit: "Fit") -> Equations:
        """The equations of turns, lengths and loop closures."""
        equations = Equations()
        add_odometry(equations, self.bars, self.joints, fit.part, self.cut, self.curvature, fit.scale)
        add_links(equations, self.bars, self.links, fit.inliers)
        return equations


@dataclass
class Fit:
    """A fit of the bars."""

    part: np.ndarray  # Part of the drive of each bar (B,)
    samples: np.ndarray  # Samples of the unknowns' errors (count, SAMPLES)
    inliers: Inliers
    scale: Scale  # How many times larger the errors of turns and lengths were than expected
    # Of each round, positions (r, 2) and headings (r,) of the readings, and the inliers (m,)
    rounds: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)

    def move(self, bars: Bars, solved: tuple[np.ndarray, np.ndarray]) -> None:
        """Move the bars by a step of Gauss-Newton."""
        step, self.samples = solved
        angles = step[:-SHARED_UNKNOWNS].reshape(-1, 4)[:, 2:]
        angles[...] = angles.clip(-MAX_TURN, MAX_TURN)
        bars.move(step)

    def keep(self, bars: Bars) -> None:
        """Keep the round for the history of the map's making."""
        _, heading, _, camera = bars.locate(slice(None))
        self.rounds.append((camera.astype(np.float32), heading.astype(np.float32), self.inliers.mask))


@dataclass(frozen=True)
class CompassMap:
    """A map and how well it is known."""

    # Positions of the camera at the observations (N, 2) [m]; NaN where nothing joins them to the rest
    places: np.ndarray
    heading: np.ndarray  # Heading of the robot at each (N,) [rad]
    std: np.ndarray  # Standard deviation of each position along either axis, after alignment of the whole map (N,) [m]
    error: np.ndarray  # Samples of the positions' errors after alignment (N, 2, SAMPLES) [m]
    # Observations that look-alikes would let lie elsewhere, or that nothing joins to the rest (N,) bool
    undecided: np.ndarray
    # Curvature of what the robot drives for straight [1 / m], the camera's place ahead of the axle and to its left
    # [m] (3,)
    shared: np.ndarray
    shared_std: np.ndarray  # Their standard deviations (3,)
    closures: Closures  # The loop closures that were tried
    stages: tuple[Stage, ...]  # How the map was made, its last stage last
    layout: Layout
    fit: Fit


def find_compass_map(
    segments: Segments,
    turns: CompassTurns,
    closures: Closures,
    observations: int,
    rng: np.random.Generator,
    curvature: float = 0.0,
) -> CompassMap:
    """Lay the segments out, refine them with their loop closures, and join the parts of the drive.

    Segments are all of them, in the order driven, with expected errors; ``rng`` draws the samples of the map's errors,
    and ``curvature`` [1 / m] is that of what the robot drives for straight, as far as it is known before the map.
    """
    layout, fit = _find(segments, turns, closures, observations, rng, curvature)
    if fit.scale.length > UNDERSTATED_RATIO:  # bars are too long for readings that err so much more
        assert segments.variance is not None
        variance, rounding_m2 = (part * fit.scale.length**2 for part in (segments.variance, segments.rounding_m2))
        segments = replace(segments, variance=variance, rounding_m2=rounding_m2)
        layout, fit = _find(segments, turns, closures, observations, rng, curvature)
    return _describe(layout, fit, closures, observations, rng)


def refine(found: CompassMap, factors: Factors, rng: np.random.Generator) -> CompassMap:
    """The map moved so that its images are also where they are registered on one another."""
    layout, fit = deepcopy(found.layout), deepcopy(found.fit)
    bars, scale = layout.bars, 1.0
    read = factors.number(bars.find_readings(len(found.places)))
    for _ in range(FACTOR_ROUNDS):
        equations = layout.relate(fit)
        add_factors(equations, bars, read, scale)
        fit.move(bars, equations.solve(*hold_length(bars, layout.links, fit.inliers), rng))
        fit.scale = rescale(bars, layout.joints, fit.part, layout.cut, fit.samples, fit.scale)
        scale = rescale_factors(bars, read, fit.samples, scale)
    even_out(bars, layout.laid_out, read, scale, fit.scale.length)
    fit.keep(bars)
    return _describe(layout, fit, found.closures, len(found.places), rng)


def _find(
    segments: Segments,
    turns: CompassTurns,
    closures: Closures,
    observations: int,
    rng: np.random.Generator,
    curvature: float,
) -> tuple[Layout, Fit]:
    bars = lay_out(segments, turns, curvature)
    joints, links = make_joints(bars, turns), link(bars, closures, observations)
    cut = (joints.angle_std > CUT_STD_RAD) | (joints.jump_std > CUT_STD_M)
    layout = Layout(bars, replace(bars), joints, links, cut, curvature)
    fit = _fit(layout, rng)
    for _ in range(RECUTS):
        wrong = find_contradicted(bars, fit.part, links, fit.inliers) & ~layout.cut
        if not wrong.any():
            break
        layout.cut, before = layout.cut | wrong, fit.rounds
        fit = _fit(layout, rng)
        fit.rounds[:0] = before
    return layout, fit


def _fit(layout: Layout, rng: np.random.Generator) -> Fit:
    """Refine the parts between the joints that are cut, and join them, until no more stay joined when refined."""
    bars, links, cut = layout.bars, layout.links, layout.cut
    none = np.zeros(len(links.one), bool)
    inliers = Inliers(none, np.ones(len(none)), np.ones(len(none)), np.inf)
    fit = Fit(np.append(0, np.cumsum(cut)), np.empty(0), inliers, Scale())
    fit.keep(bars)
    fewest, attempts = len(cut) + 2, 0
    while True:
        _settle(fit, layout, rng)
        parts = len(np.unique(fit.part))
        attempts = 0 if parts < fewest else attempts + 1
        if attempts == ATTEMPTS:
            return fit
        fewest, joined = min(parts, fewest), none.copy()
        while (more := join_parts(bars, fit.part, links)).any():
            joined |= more
        if not joined.any():
            return fit
        fit.inliers = fit.inliers._replace(mask=fit.inliers.mask | joined)


def _settle(fit: Fit, layout: Layout, rng: np.random.Generator) -> None:
    """Move the bars by Gauss-Newton with robust weights until they rest, at first with narrow gates alone."""
    bars, links = layout.bars, layout.links
    narrow, inliers, left = True, [0], MAX_ROUNDS
    while left > 0:
        fit.part = find_parts(bars, links, layout.cut, fit.inliers)
        before = bars.camera
        fit.move(bars, layout.relate(fit).solve(*hold_length(bars, links, fit.inliers), rng))
        fit.inliers = find_inliers(bars, carry(bars, fit.samples), fit.part, links, narrow)
        fit.scale = rescale(bars, layout.joints, fit.part, layout.cut, fit.samples, fit.scale)
        fit.keep(bars)
        inliers.append(int(fit.inliers.mask.sum()))
        grows = inliers[-1] > (1.0 + MIN_GROWTH) * inliers[max(-1 - GROWTH_ROUNDS, -len(inliers))]
        rests = (
            np.abs(bars.camera - before).max() < CONVERGENCE_M
            and abs(np.diff(inliers[-2:])) <= CONVERGENCE_SHARE * inliers[-1]
        )
        if rests and not narrow:
            break
        narrow = narrow and grows and not rests
        left = MAX_ROUNDS if grows else left - 1


def _describe(layout: Layout, fit: Fit, closures: Closures, observations: int, rng: np.random.Generator) -> CompassMap:
    bars, links = layout.bars, layout.links
    part, inliers, samples = fit.part, fit.inliers, fit.samples
    main = part[bars.row] == np.bincount(part[bars.row]).argmax()
    places, heading = np.full((observations, 2), np.nan), np.full(observations, np.nan)
    error = np.full((observations, 2, SAMPLES), np.nan)
    seen, first = np.unique(bars.observation[main], return_index=True)  # at a turn: as it was before the turn
    taken = np.flatnonzero(main)[first]
    camera, heading[seen] = bars.camera[taken], bars.heading[taken]
    places[seen] = camera
    uneven = fit.scale.length * bars.draw_unevenness(SAMPLES, rng)
    error[seen] = align_samples(camera, (carry(bars, samples) + uneven)[taken])
    std = np.sqrt((error**2).mean(axis=2).sum(axis=1) / 2.0)
    undecided = np.zeros(observations, bool)
    undecided[bars.observation] = True  # an observation whose readings were all lost is no part of the map
    undecided &= ~(GATE * np.sqrt(2.0) * std < limit_gate(inliers.repeats_m))
    doubted = find_doubted(bars, links, inliers)
    undecided[bars.observation[doubted[bars.segment[bars.row]]]] = True
    stages = _thin_out(bars, links, fit, main, len(closures.first), observations)
    shared_std = np.sqrt((samples[-SHARED_UNKNOWNS:] ** 2).mean(axis=1))
    return CompassMap(places, heading, std, error, undecided, bars.shared, shared_std, closures, stages, layout, fit)


def _thin_out(
    bars: Bars, links: Links, fit: Fit, main: np.ndarray, closures: int, observations: int
) -> tuple[Stage, ...]:
    """At most ``MAX_STAGES`` of a fit's rounds, with the first and the last; readings of the ``main`` part first."""
    rounds = len(fit.rounds)
    chosen = np.unique(np.geomspace(1, rounds, min(MAX_STAGES, rounds)).round().astype(int)) - 1
    order = np.argsort(~main, kind="stable")
    seen, first = np.unique(bars.observation[order], return_index=True)
    first, stages = order[first], []
    for number in chosen:
        camera, direction, inliers = fit.rounds[number]
        places, heading = np.full((observations, 2), np.nan, np.float32), np.full(observations, np.nan, np.float32)
        places[seen], heading[seen] = camera[first], direction[first]
        of_all = np.zeros(closures, bool)
        of_all[links.number] = inliers
        stages.append(Stage(places, heading, of_all, int(number)))
    return tuple(stages)


def align_samples(places: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Errors (r, 2, k) without the motion of the whole map that each sample contains."""
    centred = places - places.mean(axis=0)
    error = error - error.mean(axis=0)
    about = np.stack([-centred[:, 1], centred[:, 0]], axis=1)
    angle = np.einsum("ra,rak->k", about, error) / (about**2).sum()
    return error - about[:, :, None] * angle
