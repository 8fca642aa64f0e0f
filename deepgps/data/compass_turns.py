"""Turns between segments by the compass: how far the heading changes, from the images before and after each turn.

The wheels choose between the peaks of the compass and count whole turns; they never change an angle. The ground truth
is not used.
"""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.data.dead_reckoning import dead_reckon, travel
from deepgps.data.lean import compare_images
from deepgps.data.segments import find_runs
from sim.recording.format import Recording
from sim.recording.turns import KINDS, Turns
from sim.sensors.camera.mount import Upright
from sim.sensors.compass.compass import disambiguate

WHEELS_RAD, PUSHED_RAD = 0.3, 1.5
"""Standard deviations of a turn by the wheels, to choose between peaks: they may slip, and what the robot touched may
have turned it by a right angle while they did not move [rad]."""
WANDER_RAD = np.radians(0.07)
"""Standard deviation of a segment's mean heading against its heading at the ends [rad]."""
BACKED_OFF_M, MEETING_M = 0.05, 0.001
"""Standard deviations of where a segment begins after the robot backed off, and where it turned in place [m]."""
UNEVEN = 0.3
"""Standard deviation of the distance between images, as a part of it, where readings were lost."""
UNKNOWN_RAD, UNKNOWN_M = 3.0, 10.0
"""Standard deviations of a turn and of a way of which nothing is known: the robot was carried [rad], [m]."""


@dataclass(frozen=True)
class CompassTurns:
    """The turns between consecutive rows of ``Segments``.

    Attributes:
        angle: Turn to the left (L - 1,) [rad].
        angle_std: Its standard deviation (L - 1,) [rad].
        jump: From the end of a segment to the beginning of the next, in the frame of the first (L - 1, 2) [m].
        jump_std: Its standard deviation along each axis (L - 1,) [m].
        upright: What sets images of the camera upright; the angles are corrected for its lean.
    """

    angle: np.ndarray
    angle_std: np.ndarray
    jump: np.ndarray
    jump_std: np.ndarray
    upright: Upright | None = None


def measure_turns(recording: Recording) -> CompassTurns:
    """Measure all turns of a recording, and the camera's lean, which changes what an image shows of a turn.

    Raises:
        InputError: The recording has no turns or no polar images.
    """
    (seen, upright), turns = compare_images(recording), recording.turns
    assert turns is not None
    yaw = dead_reckon(recording)[:, 2]
    wheels = yaw[turns.after] - yaw[turns.after - 1]
    spread = trust_wheels(turns)
    found = disambiguate(seen, wheels, spread)
    known = np.isfinite(found.angle[:, 0]) & (turns.kind != KINDS.index("relocated"))
    angle = np.where(known, found.angle[:, 0], wheels)
    likely = np.where(found.weight > 0.0, found.weight, 0.0)
    apart = np.nansum(likely * (found.angle - found.angle[:, :1]) ** 2, axis=1)  # where several peaks are likely
    variance = np.where(known, found.std[:, 0] ** 2 + WANDER_RAD**2 + apart, spread**2)
    return replace(_join(recording, angle, variance), upright=upright)


def trust_wheels(turns: Turns) -> np.ndarray:
    """Standard deviation of each turn (T,) by the wheels, to choose between peaks of the compass [rad]."""
    return np.where(turns.kind == KINDS.index("in_place"), WHEELS_RAD, PUSHED_RAD)


def _join(recording: Recording, angle: np.ndarray, variance: np.ndarray) -> CompassTurns:
    """Turns (L - 1) between the segments that have at least two readings, from all turns (T,)."""
    assert recording.turns is not None
    turns, runs = recording.turns, find_runs(recording)
    travelled = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    numbers = {int(row): number for number, row in enumerate(turns.after)}
    rows, turned, squared = [], 0.0, 0.0
    jump, jump_squared = np.zeros(2), MEETING_M**2
    gap = np.diff(recording.reading[:, :2], axis=0)
    beside = (gap[:, 0] == 0) & (gap[:, 1] == 1)
    step_m = float(np.median(np.abs(np.diff(travelled)[beside]))) if beside.any() else 0.0
    begun = False
    for before, run in zip([runs[0], *runs], runs, strict=False):
        number = numbers.get(int(run[0]))
        skipped = recording.reading[run[0], 0] - recording.reading[before[-1], 0] > 1
        if begun and (number is None or skipped):
            squared, jump_squared = squared + UNKNOWN_RAD**2, jump_squared + UNKNOWN_M**2
        if begun and number is not None:
            way_m = travelled[run[0]] - travelled[before[-1]]
            last, place, first = recording.reading[before[-1], 1], turns.before[number], recording.reading[run[0], 1]
            ahead = _direct(turned)
            if KINDS[turns.kind[number]] == "relocated":
                squared, jump_squared = squared + UNKNOWN_RAD**2, jump_squared + UNKNOWN_M**2
            elif KINDS[turns.kind[number]] == "backed_off":
                on_m = max(first - place - 1, 0) * step_m  # driven after it, before the first reading that arrived
                jump = jump + (way_m - on_m) * ahead + on_m * _direct(turned + angle[number])
                jump_squared += BACKED_OFF_M**2 + (UNEVEN * on_m) ** 2
            elif first > last:  # readings at the turn were lost
                share = (place - last) / (first - last)
                jump = jump + way_m * (share * ahead + (1.0 - share) * _direct(turned + angle[number]))
                if last < place < first:  # nothing was measured at the turn itself: images are evenly spaced, roughly
                    jump_squared += (UNEVEN * way_m / (first - last)) ** 2
            turned, squared = turned + angle[number], squared + variance[number]
        if len(run) >= 2:
            if begun:
                rows.append((turned, np.sqrt(squared), *jump, np.sqrt(jump_squared)))
            begun, turned, squared, jump, jump_squared = True, 0.0, 0.0, np.zeros(2), MEETING_M**2
    table = np.array(rows).reshape(-1, 5)
    return CompassTurns(table[:, 0], table[:, 1], table[:, 2:4], table[:, 4])


def _direct(heading: float) -> np.ndarray:
    return np.array([np.cos(heading), np.sin(heading)])
