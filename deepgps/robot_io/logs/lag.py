"""Wheels against images: how much later than the images the wheels are, and where both contradict each other.

The lag is the shift in time at which the wheels turn as the images do in turns in place; elsewhere, neither may turn.
"""

from typing import NamedTuple

import numpy as np

from deepgps.data.turns import compare_headings
from deepgps.robot_io.logs.camera import PolarSource
from deepgps.robot_io.logs.drive import LoggedDrive
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.geometry import wrap

MAX_LAG_S = 0.5  # Largest lag that is looked for [s]
STEP_S = 0.002
OUTLIER_RAD = 0.1  # Differences from here on count no more [rad]
MIN_TURN_RAD = 0.05  # Turns between two images that are smaller than this tell nothing [rad]
MIN_PAIRS = 12  # Fewest pairs of images from which something is concluded
MAX_PAIRS = 400  # Pairs of images in turns, and elsewhere, that are looked at
PAIR_S = (0.19, 0.5)
"""Shortest and longest time between the two images of a pair [s]: two images of a fast camera hardly differ."""
TURN_MARGIN_S = 0.3  # Images are looked at this long before and after a turn [s]
MIN_AGREEING_SHARE = 0.5  # Share of turns in which images and wheels must agree
UNIT_RATIO = 10.0
"""How many times as far as the images the wheels turn at least if their angles are in degrees or ticks."""
MIN_SEEN_SHARE = 0.2  # Share of the wheels' turns below which images seem not to turn. Good logs have nearly all
VISIBLE_TURN_RAD = 0.15  # Turn of the wheels between two images that images show whatever their lag [rad]
MAX_ODD_SHARE = 0.2  # Share of turns in which images may stand still, and of other pairs in which they may turn
MAX_LAG_ERROR_S = 0.02  # Difference between the lag that is given and the measured one from which it is noted [s]


class Pairs(NamedTuple):
    """Pairs of images and the turns between them."""

    first_s: np.ndarray  # Time of the first image of each (p,) [s]
    second_s: np.ndarray  # Time of the second one (p,) [s]
    turned: np.ndarray  # The turn between them by the images (p,) [rad], to the left
    in_turn: np.ndarray  # Whether both were taken in a turn in place by the wheels, or shortly before or after (p,)

    def follow(self, time_s: np.ndarray, values: np.ndarray, lag_s: float = 0.0) -> np.ndarray:
        """Changes (p,) of some values (n,) at times (n,) [s] of the wheels."""
        return np.interp(self.second_s + lag_s, time_s, values) - np.interp(self.first_s + lag_s, time_s, values)


class Lag(NamedTuple):
    """A lag."""

    seconds: float  # How much later than the images the wheels are [s]
    agree: float  # Share of pairs in which wheels and images turn by the same angle then
    mirrored: float  # The same share if images turned the other way
    pairs: int  # Number of pairs
    ratio: float  # How many times as far the wheels turn, as a median


def estimate_lag(pairs: Pairs, time_s: np.ndarray, yaw: np.ndarray) -> Lag | None:
    """The lag at which the wheels' heading (n,) [rad] at times (n,) [s] turns as the images; None: too few turns."""
    pairs = Pairs(*(values[pairs.in_turn & (np.abs(pairs.turned) > MIN_TURN_RAD)] for values in pairs))
    if len(pairs.turned) < MIN_PAIRS:
        return None

    def differ(lag_s: float, sign: float) -> np.ndarray:
        return np.abs(wrap(sign * pairs.turned - pairs.follow(time_s, yaw, lag_s)))

    def best(sign: float) -> tuple[float, float]:
        lags = np.arange(-MAX_LAG_S, MAX_LAG_S + STEP_S / 2, STEP_S)
        cost = [np.minimum(differ(lag, sign) ** 2, OUTLIER_RAD**2).sum() for lag in lags]
        lag_s = float(lags[int(np.argmin(cost))])
        return lag_s, float((differ(lag_s, sign) < OUTLIER_RAD / 2).mean())

    (lag_s, agree), (_, mirrored) = best(1.0), best(-1.0)
    ratio = float(np.median(np.abs(pairs.follow(time_s, yaw, lag_s) / pairs.turned)))
    return Lag(round(lag_s, 4), agree, mirrored, len(pairs.turned), ratio)


def compare_wheels(
    source: PolarSource, drive: LoggedDrive, given: float | str, progress: Report
) -> tuple[float, list[str]]:
    """The lag that counts [s], which is the given one or is estimated, and what the user should know of wheels and
    images; raises InputError if they contradict each other, or the lag cannot be estimated."""
    first, second, in_turn = _pair_images(drive)
    wanted, rows = np.unique((first, second), return_inverse=True)
    images = source.draw(wanted, progress, "see turns")
    turned = compare_headings(images, *rows.reshape(2, -1)).turn
    pairs = Pairs(drive.image_s[first], drive.image_s[second], turned, in_turn)
    time_s, path = drive.driven.wheels.time_s, drive.driven.path
    lag_s, notes = judge_pairs(pairs, time_s, path.yaw, path.travelled_m, given, source.topic)
    if drive.pose is not None:
        poses = pairs._replace(turned=wrap(drive.pose[second, 2] - drive.pose[first, 2]))
        lags = [one.seconds for one in (estimate_lag(some, time_s, path.yaw) for some in (pairs, poses)) if one]
        if len(lags) == 2 and abs(late_s := lags[0] - lags[1]) > MAX_LAG_ERROR_S:
            notes.append(f"poses come {1000 * late_s:+.0f} ms later than images, by their turns: do clocks differ?")
    return lag_s, notes


def _pair_images(drive: LoggedDrive) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of the first and second image of pairs in turns and elsewhere, and whether each is in a turn."""
    wheels, order = drive.driven.wheels, np.argsort(drive.image_s, kind="stable")
    order = order[np.isfinite(drive.image_s[order])]
    image_s, inside = drive.image_s[order], np.zeros(len(order), bool)
    for one in drive.driven.motions:
        if one.kind == "turn":
            span = wheels.time_s[one.first] - TURN_MARGIN_S, wheels.time_s[one.last] + TURN_MARGIN_S
            inside[slice(*np.searchsorted(image_s, span))] = True
    second = np.searchsorted(image_s, image_s + PAIR_S[0])
    known, breaks = ~np.isnan(wheels.at(image_s)[:, 0]), wheels.count_breaks(image_s)
    first = np.flatnonzero((second < len(order)) & known)
    first = first[known[second[first]] & (breaks[second[first]] == breaks[first])]
    first = first[image_s[second[first]] - image_s[first] < PAIR_S[1]]
    some = []
    for kind in (False, True):
        rows = first[(inside[first] == kind) & (inside[second[first]] == kind)]
        some.append(rows[np.unique(np.linspace(0, len(rows) - 1, MAX_PAIRS).astype(int))] if len(rows) else rows)
    first = np.concatenate(some)
    return order[first], order[second[first]], inside[first]


def judge_pairs(
    pairs: Pairs, time_s: np.ndarray, yaw: np.ndarray, travelled_m: np.ndarray, given: float | str, topic: str
) -> tuple[float, list[str]]:
    """Like ``compare_wheels``, by pairs of a topic's images, and heading (n,) [rad] and distance (n,) [m] by the wheels
    at times (n,) [s]."""
    seen, by_wheels, still = np.abs(pairs.turned), np.abs(pairs.follow(time_s, yaw)), MIN_TURN_RAD / 2
    turns, others = pairs.in_turn & (by_wheels > MIN_TURN_RAD), ~pairs.in_turn
    odd = others & (by_wheels < still) & (seen > OUTLIER_RAD)
    odd_share, odd_deg = odd.sum() / max(others.sum(), 1), np.degrees(seen[odd].sum())
    turning = others & (seen > still)
    if min(turns.sum(), turning.sum()) >= MIN_PAIRS and turning.sum() > MAX_ODD_SHARE * others.sum():
        # a turn to the left seems to go forward if the left wheel counts backward, and backward if the right one does
        ahead = (pairs.follow(time_s, travelled_m) * pairs.turned)[others].sum()
        if (share := (seen[turns] > still).mean()) < MIN_SEEN_SHARE:
            raise InputError(
                f"wheels.left, wheels.right: they turn against each other in {turns.sum()} pairs of images of which "
                f"{share:.0%} turn, and images turn where they do not: one of them counts backward, by the images the "
                f"{'left' if ahead > 0 else 'right'} one (wheels.backward)"
            )
    if odd.sum() >= MIN_PAIRS and by_wheels.sum() < MAX_ODD_SHARE * seen[odd].sum():
        raise InputError(
            f"wheels.left, wheels.right: images turn by {odd_deg:.0f} deg in {odd.sum()} of {others.sum()} pairs, and "
            "the wheels never differ: do both joints move alike, or has the odometry no orientation?"
        )
    notes = []
    if odd.sum() >= MIN_PAIRS and odd_share > MAX_ODD_SHARE:
        notes.append(
            f"{topic}: in {odd_share:.0%} of {others.sum()} pairs taken while the wheels do not turn, images do, by "
            f"{odd_deg:.0f} deg in all: do wheels slip, or miss counts?"
        )
    clear = pairs.in_turn & (by_wheels > VISIBLE_TURN_RAD)
    frozen = clear & (seen < still)
    if clear.sum() >= MIN_PAIRS and frozen.sum() > MAX_ODD_SHARE * clear.sum():
        notes.append(
            f"{topic}: in {frozen.sum() / clear.sum():.0%} of {clear.sum()} pairs taken while the wheels turn, images "
            f"do not turn, first at {pairs.first_s[frozen].min():.1f} s: is the camera frozen or covered there?"
        )
    lag = estimate_lag(pairs, time_s, yaw)
    if lag is None and given == "estimate":
        raise InputError(
            f"wheels.lag_s estimate: fewer than {MIN_PAIRS} pairs of images show a turn in place; give a number"
        )
    if lag is None:
        return float(given), notes
    if lag.agree < MIN_AGREEING_SHARE and lag.mirrored > max(MIN_AGREEING_SHARE, lag.agree + 0.2):
        raise InputError(
            f"in {lag.mirrored:.0%} of {lag.pairs} turns images turn against the wheels: camera.mirrored is wrong, "
            "wheels.left and wheels.right are exchanged, or both wheels count backward (wheels.backward)"
        )
    if lag.ratio > UNIT_RATIO:
        raise InputError(
            f"wheels.left, wheels.right: they turn {lag.ratio:.0f} times as far as the images: their positions must be "
            "angles in radians"
        )
    if lag.agree < MIN_AGREEING_SHARE:
        notes.append(
            f"in only {lag.agree:.0%} of {lag.pairs} turns images and wheels agree, and "
            f"the wheels turn {lag.ratio:.2g} times as far: check radius, track, lens"
        )
    if given == "estimate":
        return lag.seconds, [*notes, f"the wheels are {1000 * lag.seconds:.0f} ms later than the images"]
    if abs(lag.seconds - float(given)) > MAX_LAG_ERROR_S:
        notes.append(f"wheels.lag_s is {given} s, but the turns show {lag.seconds:.3f} s")
    return float(given), notes
