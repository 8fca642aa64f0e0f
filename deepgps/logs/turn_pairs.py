"""The lag of the wheels against the images of a log, measured at its turns in place, and which lag counts."""

from typing import IO

import numpy as np

from deepgps.logs.drive import Drive
from deepgps.logs.lag import FEWEST, Lag, Pairs, estimate_lag, measure_shift
from deepgps.logs.polar import PolarSource
from deepgps.progress import Report
from sim.errors import InputError

MOST_PAIRS = 400
"""Pairs of images from which the lag is estimated at most."""
LONGEST_PAIR_S = 0.5
"""Longest time between the two images of a pair [s]."""
AROUND_S = 0.3
"""Images are looked at this long before and after a turn [s]."""
AGREE = 0.5
"""Share of turns in which images and wheels must agree."""


def measure_lag(source: PolarSource, drive: Drive, file: IO[bytes], progress: Report) -> Lag | None:
    """How much later than the images the wheels are; None: no turn shows it."""
    first, second = _pair_images(drive)
    wanted = np.unique(np.concatenate([first, second]))
    source.draw(wanted.tolist(), file, progress, "see turns")
    images = source.map(file, len(wanted))
    rows = np.searchsorted(wanted, first), np.searchsorted(wanted, second)
    turned = [measure_shift(images[one], images[other]) for one, other in zip(*rows, strict=True)]
    pairs = Pairs(drive.image_s[first], drive.image_s[second], np.array(turned))
    return estimate_lag(pairs, drive.wheels.time_s, drive.path.yaw)


def _pair_images(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the first and second image of pairs in and around turns, spread over the drive."""
    order = np.argsort(drive.image_s, kind="stable")
    order = order[np.isfinite(drive.image_s[order])]
    image_s, time_s = drive.image_s[order], drive.wheels.time_s
    inside = np.zeros(len(order), bool)
    for motion in drive.motions:
        if motion.kind == "turn":
            begin, end = time_s[motion.first] - AROUND_S, time_s[motion.last] + AROUND_S
            inside[slice(*np.searchsorted(image_s, (begin, end)))] = True
    rows = np.flatnonzero(inside[:-1] & inside[1:] & (np.diff(image_s) < LONGEST_PAIR_S))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, MOST_PAIRS).astype(int))] if len(rows) else rows
    return order[rows], order[rows + 1]


def choose_lag(given: float | str, lag: Lag | None) -> tuple[float, list[str]]:
    """The lag that counts, and what the user should know of it.

    Args:
        given: The lag by the robot's file [s], or ``estimate``.
        lag: The lag by turns; None: they do not show it.

    Raises:
        InputError: Images turn against the wheels, or the lag cannot be estimated.
    """
    if lag is None:
        if given == "estimate":
            raise InputError(
                f"wheels.lag_s estimate: fewer than {FEWEST} pairs of images show a turn in place; give a number"
            )
        return float(given), []
    if lag.agree < AGREE and lag.mirrored > max(AGREE, lag.agree + 0.2):
        raise InputError(
            f"in {lag.mirrored:.0%} of {lag.pairs} turns images turn against the wheels: camera.mirrored is wrong, or "
            "wheels.left and wheels.right are exchanged"
        )
    notes = []
    if lag.agree < AGREE:
        notes.append(f"in only {lag.agree:.0%} of {lag.pairs} turns images and wheels agree: check track, radius, lens")
    if given == "estimate":
        return lag.seconds, [*notes, f"the wheels are {1000 * lag.seconds:.0f} ms later than the images"]
    if abs(lag.seconds - float(given)) > 0.02:
        notes.append(f"wheels.lag_s is {given} s, but the turns show {lag.seconds:.3f} s")
    return float(given), notes
