"""Wheels against images: how much later than the images the wheels are, and where both contradict each other.

The turn between two images is the circular shift that makes their rings agree best. The lag is the shift in time at
which the wheels turn as the images do in turns in place; elsewhere, neither may turn.
"""

from collections.abc import Callable
from typing import IO, NamedTuple

import numpy as np

from deepgps.robot_io.logs.camera import PolarSource
from deepgps.robot_io.logs.drive import LoggedDrive
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.geometry import wrap

OVERSAMPLING = 16  # Points between two sectors at which shifts are compared
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


def measure_shift(first: np.ndarray, second: np.ndarray) -> float:
    """Turn to the left between two polar images (rings, sectors, 3) of one place [rad], by cross-correlation."""
    one, two = (np.fft.rfft(_sharpen(image), axis=1) for image in (first, second))
    sectors = first.shape[1]
    likely = np.fft.irfft((one * two.conj()).sum(axis=(0, 2)), sectors * OVERSAMPLING)
    return float(wrap(2 * np.pi * np.argmax(likely) / (sectors * OVERSAMPLING)))


def _sharpen(image: np.ndarray) -> np.ndarray:
    """Differences along the rings, weighted by their length."""
    light = image.astype(np.float32)
    size = np.arange(1, len(light) + 1)[:, None, None]
    return (light - np.roll(light, 1, axis=1)) * np.sqrt(size)


def estimate_lag(pairs: Pairs, time_s: np.ndarray, yaw: np.ndarray) -> Lag | None:
    """The lag at which the wheels' heading (n,) [rad] at times (n,) [s] turns as the images; None: too few turns."""
    pairs = Pairs(*(values[np.abs(pairs.turned) > MIN_TURN_RAD] for values in pairs))
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
    source: PolarSource, drive: LoggedDrive, given: float | str, file: IO[bytes], progress: Report
) -> tuple[float, list[str]]:
    """The lag that counts [s], and what the user should know of wheels and images.

    Args:
        source: Images of the log.
        drive: Its drive.
        given: The lag by the robot's file [s], or ``estimate``.
        file: Takes the images that are looked at.
        progress: Called with what is done.

    Raises:
        InputError: They contradict each other, or the lag cannot be estimated.
    """
    numbers = [_pair_images(drive, in_turns) for in_turns in (True, False)]
    wanted = np.unique(np.concatenate([one for two in numbers for one in two]))
    images = source.draw(wanted.tolist(), file, progress, "see turns")

    def measure(first: np.ndarray, second: np.ndarray) -> Pairs:
        rows = zip(*np.searchsorted(wanted, (first, second)), strict=True)
        turned = [measure_shift(images[one], images[other]) for one, other in rows]
        return Pairs(drive.image_s[first], drive.image_s[second], np.array(turned))

    turns, others = measure(*numbers[0]), measure(*numbers[1])
    notes = judge_pairs(
        turns, others, drive.driven.wheels.time_s, drive.driven.path.yaw, drive.driven.path.travelled_m, source.topic
    )
    lag_s, more = choose_lag(given, estimate_lag(turns, drive.driven.wheels.time_s, drive.driven.path.yaw))
    return lag_s, notes + more


def judge_pairs(
    turns: Pairs, others: Pairs, time_s: np.ndarray, yaw: np.ndarray, travelled_m: np.ndarray, topic: str
) -> list[str]:
    """What the user should know of images that do not turn with the wheels, or turn without them.

    Args:
        turns: Pairs of images in turns in place by the wheels.
        others: Other pairs.
        time_s: Times of the wheels (n,) [s].
        yaw: Heading by the wheels (n,) [rad].
        travelled_m: Distance by the wheels (n,) [m].
        topic: The images' topic.

    Raises:
        InputError: One wheel counts backward, or both move alike while images turn.
    """
    by_wheels, beside = turns.follow(time_s, yaw), others.follow(time_s, yaw)
    seen, odd = np.abs(turns.turned[np.abs(by_wheels) > MIN_TURN_RAD]), np.abs(others.turned)
    odd = odd[(np.abs(beside) < MIN_TURN_RAD / 2) & (odd > OUTLIER_RAD)]
    share, degrees = len(odd) / max(len(others.turned), 1), np.degrees(odd.sum())
    turning = np.abs(others.turned) > MIN_TURN_RAD / 2
    if len(seen) >= MIN_PAIRS and (seen > MIN_TURN_RAD / 2).mean() < MIN_SEEN_SHARE:
        # a turn to the left seems to go forward if the left wheel counts backward, and backward if the right one does
        wheel = "left" if float(others.follow(time_s, travelled_m) @ others.turned) > 0 else "right"
        if turning.sum() >= MIN_PAIRS and turning.mean() > MAX_ODD_SHARE:
            raise InputError(
                f"wheels.left, wheels.right: they turn against each other in {len(seen)} pairs of images of which "
                f"{(seen > MIN_TURN_RAD / 2).mean():.0%} turn, and images turn where they do not: one of them counts "
                f"backward, by the images the {wheel} one (wheels.backward)"
            )
    if len(odd) >= MIN_PAIRS and np.abs(np.r_[by_wheels, beside]).sum() < MAX_ODD_SHARE * odd.sum():
        raise InputError(
            f"wheels.left, wheels.right: images turn by {degrees:.0f} deg in {len(odd)} of {len(others.turned)} pairs, "
            "and the wheels never differ: do both joints move alike, or has the odometry no orientation?"
        )
    notes = []
    if len(odd) >= MIN_PAIRS and share > MAX_ODD_SHARE:
        notes.append(
            f"{topic}: in {share:.0%} of {len(others.turned)} pairs taken while the wheels do not turn, images do, by "
            f"{degrees:.0f} deg in all: do wheels slip, or miss counts?"
        )
    some = np.abs(by_wheels) > VISIBLE_TURN_RAD
    still = some & (np.abs(turns.turned) < MIN_TURN_RAD / 2)
    if some.sum() >= MIN_PAIRS and still.sum() > MAX_ODD_SHARE * some.sum():
        notes.append(
            f"{topic}: in {still.sum() / some.sum():.0%} of {some.sum()} pairs taken while the wheels turn, images do "
            f"not turn, first at {turns.first_s[still].min():.1f} s: is the camera frozen or covered there?"
        )
    return notes


def _pair_images(drive: LoggedDrive, in_turns: bool) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the first and second image of pairs in turns and shortly before and after, or elsewhere."""
    order = np.argsort(drive.image_s, kind="stable")
    order = order[np.isfinite(drive.image_s[order])]
    image_s, time_s = drive.image_s[order], drive.driven.wheels.time_s
    margin = TURN_MARGIN_S * np.array([-1.0, 1.0])
    spans = [time_s[[one.first, one.last]] + margin for one in drive.driven.motions if one.kind == "turn"]
    inside = np.zeros(len(order), bool)
    for span in spans:
        inside[slice(*np.searchsorted(image_s, span))] = True
    fits: Callable[[np.ndarray], np.ndarray] = (lambda rows: inside[rows]) if in_turns else (lambda rows: ~inside[rows])
    second = np.searchsorted(image_s, image_s + PAIR_S[0])
    rows = np.flatnonzero((second < len(order)) & (image_s >= time_s[0]) & (image_s <= time_s[-1]))
    rows = rows[fits(rows) & fits(second[rows]) & (image_s[second[rows]] - image_s[rows] < PAIR_S[1])]
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, MAX_PAIRS).astype(int))] if len(rows) else rows
    return order[rows], order[second[rows]]


def choose_lag(given: float | str, lag: Lag | None) -> tuple[float, list[str]]:
    """The lag that counts [s], given or ``estimate``, and notes, by that of the turns; None: they do not show it.

    Raises:
        InputError: Images turn against the wheels, the wheels are not in radians, or the lag cannot be estimated.
    """
    if lag is None:
        if given == "estimate":
            raise InputError(
                f"wheels.lag_s estimate: fewer than {MIN_PAIRS} pairs of images show a turn in place; give a number"
            )
        return float(given), []
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
    notes = []
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
