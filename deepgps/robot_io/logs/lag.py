"""How much later than the images the wheels are, from turns in place that both see, and which lag counts.

The turn between two images is the circular shift that makes their rings agree best. The lag is the shift in time at
which the wheels turn as the images do.
"""

from collections.abc import Collection
from typing import IO, NamedTuple

import numpy as np

from deepgps.robot_io.logs.camera import PolarSource
from deepgps.robot_io.logs.drive import LoggedDrive
from deepgps.robot_io.logs.segmentation import Kind
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.geometry import wrap

OVERSAMPLING = 16  # Points between two sectors at which shifts are compared
MAX_LAG_S = 0.5  # Largest lag that is looked for [s]
STEP_S = 0.002
OUTLIER_RAD = 0.1  # Differences from here on count no more [rad]
MIN_TURN_RAD = 0.05  # Turns between two images that are smaller than this tell nothing [rad]
MIN_PAIRS = 12  # Fewest pairs of images from which a lag is estimated
MAX_PAIRS = 400  # Pairs of images from which the lag is estimated at most
PAIR_S = (0.19, 0.5)
"""Shortest and longest time between the two images of a pair [s]: two images of a fast camera hardly differ."""
TURN_MARGIN_S = 0.3  # Images are looked at this long before and after a turn [s]
MIN_AGREEING_SHARE = 0.5  # Share of turns in which images and wheels must agree
UNIT_RATIO = 10.0
"""How many times as far as the images the wheels turn at least if their angles are in degrees or ticks."""
MIN_SEEN_SHARE = 0.2  # Share of the wheels' turns below which images seem not to turn. Good logs have nearly all
VISIBLE_TURN_RAD = 0.15  # Turn of the wheels between two images that images show whatever their lag [rad]
MAX_STILL_SHARE = 0.2  # Share of such turns in which images may stand still without a note
DRIVES: tuple[Kind, ...] = ("straight", "back", "arc")
"""Motions that a turn in place becomes by wheels of which one counts backward."""


class Pairs(NamedTuple):
    """Pairs of images taken while the robot turned in place."""

    first_s: np.ndarray  # Time of the first image of each (p,) [s]
    second_s: np.ndarray  # Time of the second one (p,) [s]
    turned: np.ndarray  # The turn between them by the images (p,) [rad], to the left


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
    known = np.abs(pairs.turned) > MIN_TURN_RAD
    first_s, second_s, turned = (values[known] for values in pairs)
    if len(turned) < MIN_PAIRS:
        return None

    def turn_by_wheels(lag_s: float) -> np.ndarray:
        return np.interp(second_s + lag_s, time_s, yaw) - np.interp(first_s + lag_s, time_s, yaw)

    def differ(lag_s: float, sign: float = 1.0) -> np.ndarray:
        return np.abs(wrap(sign * turned - turn_by_wheels(lag_s)))

    def best(sign: float) -> tuple[float, float]:
        lags = np.arange(-MAX_LAG_S, MAX_LAG_S + STEP_S / 2, STEP_S)
        cost = np.array([np.minimum(differ(lag, sign) ** 2, OUTLIER_RAD**2).sum() for lag in lags])
        lag_s = float(lags[int(np.argmin(cost))])
        return lag_s, float((differ(lag_s, sign) < OUTLIER_RAD / 2).mean())

    (lag_s, agree), (_, mirrored) = best(1.0), best(-1.0)
    ratio = float(np.median(np.abs(turn_by_wheels(lag_s) / turned)))
    return Lag(round(lag_s, 4), agree, mirrored, len(turned), ratio)


def measure_lag(
    source: PolarSource, drive: LoggedDrive, file: IO[bytes], progress: Report
) -> tuple[Lag | None, list[str]]:
    """How much later than the images the wheels are, None: no turn shows it; and a note if many images do not turn.

    Args:
        source: Images of the log.
        drive: Its drive.
        file: Takes the images that are looked at.
        progress: Called with what is done.

    Raises:
        InputError: Images turn where the wheels drive, and not where they turn: one wheel counts backward.
    """
    pairs = _measure_pairs(source, _pair_images(drive, ("turn",), TURN_MARGIN_S), drive, file, progress)
    by_wheels = _turn_by_wheels(pairs, drive)
    _refuse_reversed(pairs, by_wheels, source, drive, file, progress)
    lag = estimate_lag(pairs, drive.wheels.time_s, drive.path.yaw)
    return lag, _doubt_images(pairs, by_wheels, source.topic)


def _turn_by_wheels(pairs: Pairs, drive: LoggedDrive) -> np.ndarray:
    """Turns by the wheels between the two images of pairs (p,) [rad]."""
    time_s, yaw = drive.wheels.time_s, drive.path.yaw
    return np.interp(pairs.second_s, time_s, yaw) - np.interp(pairs.first_s, time_s, yaw)


def _doubt_images(pairs: Pairs, by_wheels: np.ndarray, topic: str) -> list[str]:
    """A note if images do not turn in many turns of the wheels."""
    some = np.abs(by_wheels) > VISIBLE_TURN_RAD
    still = some & (np.abs(pairs.turned) < MIN_TURN_RAD / 2)
    if some.sum() < MIN_PAIRS or still.sum() <= MAX_STILL_SHARE * some.sum():
        return []
    return [
        f"{topic}: in {still.sum() / some.sum():.0%} of {some.sum()} pairs taken while the wheels turn, images do not "
        f"turn, first at {pairs.first_s[still].min():.1f} s: is the camera frozen or covered there?"
    ]


def _measure_pairs(
    source: PolarSource, numbers: tuple[np.ndarray, np.ndarray], drive: LoggedDrive, file: IO[bytes], progress: Report
) -> Pairs:
    """The turns by the images between the first and second image of pairs, by their numbers (p,), (p,)."""
    first, second = numbers
    wanted = np.unique(np.concatenate([first, second]))
    source.draw(wanted.tolist(), file, progress, "see turns")
    images = source.map(file, len(wanted))
    rows = np.searchsorted(wanted, first), np.searchsorted(wanted, second)
    turned = [measure_shift(images[one], images[other]) for one, other in zip(*rows, strict=True)]
    return Pairs(drive.image_s[first], drive.image_s[second], np.array(turned))


def _refuse_reversed(
    pairs: Pairs, by_wheels: np.ndarray, source: PolarSource, drive: LoggedDrive, file: IO[bytes], progress: Report
) -> None:
    """Raise InputError if the wheels turn against each other where images do not turn, and images where they do not.

    Images that show nothing, as of a covered camera, turn nowhere, so they are no reason.
    """
    turned = pairs.turned[np.abs(by_wheels) > MIN_TURN_RAD]
    if len(turned) < MIN_PAIRS or _share_turning(turned) >= MIN_SEEN_SHARE:
        return
    driven = _measure_pairs(source, _pair_images(drive, DRIVES, 0.0), drive, file, progress)
    if len(driven.turned) >= MIN_PAIRS and _share_turning(driven.turned) > MIN_AGREEING_SHARE:
        raise InputError(
            f"wheels.left, wheels.right: they turn against each other in {len(turned)} pairs of images of which "
            f"{_share_turning(turned):.0%} turn, and images turn where they do not: one of them counts backward, "
            f"by the images the {_find_reversed(driven, drive)} one (wheels.backward)"
        )


def _find_reversed(driven: Pairs, drive: LoggedDrive) -> str:
    """Which wheel counts backward, by turns that the wheels took for driving.

    A turn to the left seems to go forward if it is the left wheel, and backward if it is the right one.
    """
    time_s, travelled_m = drive.wheels.time_s, drive.path.travelled_m
    distance_m = np.interp(driven.second_s, time_s, travelled_m) - np.interp(driven.first_s, time_s, travelled_m)
    return "left" if float(distance_m @ driven.turned) > 0 else "right"


def _share_turning(turned: np.ndarray) -> float:
    """Share of turns between two images (p,) [rad] that are no error of measurement."""
    return float((np.abs(turned) > MIN_TURN_RAD / 2).mean())


def _pair_images(drive: LoggedDrive, kinds: Collection[Kind], around_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the first and second image of pairs in motions of some kinds and shortly before and after them.

    The pairs are spread over the drive.
    """
    order = np.argsort(drive.image_s, kind="stable")
    order = order[np.isfinite(drive.image_s[order])]
    image_s, time_s = drive.image_s[order], drive.wheels.time_s
    inside = np.zeros(len(order), bool)
    for motion in drive.motions:
        if motion.kind in kinds:
            begin, end = time_s[motion.first] - around_s, time_s[motion.last] + around_s
            inside[slice(*np.searchsorted(image_s, (begin, end)))] = True
    second = np.searchsorted(image_s, image_s + PAIR_S[0])
    rows = np.flatnonzero(inside & (second < len(order)))
    rows = rows[inside[second[rows]] & (image_s[second[rows]] - image_s[rows] < PAIR_S[1])]
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, MAX_PAIRS).astype(int))] if len(rows) else rows
    return order[rows], order[second[rows]]


def choose_lag(given: float | str, lag: Lag | None) -> tuple[float, list[str]]:
    """The lag that counts, and what the user should know of it.

    Args:
        given: The lag by the robot's file [s], or ``estimate``.
        lag: The lag by turns; None: they do not show it.

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
    if abs(lag.seconds - float(given)) > 0.02:
        notes.append(f"wheels.lag_s is {given} s, but the turns show {lag.seconds:.3f} s")
    return float(given), notes
