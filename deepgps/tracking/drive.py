"""A recording as the tracker takes it: its images in the order driven, and the motion from each to the next.

Along a segment the robot drives straight, or with a constant curvature; its distance is that of the wheels.
Turns are those of the compass, or of the wheels where no images show them. The image after a turn in place is one of
its own. The ground truth is not used.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepgps.data.segments import dead_reckon, find_runs, travel
from deepgps.data.turns import (
    BACK_OFF_STD_M,
    MEETING_STD_M,
    UNKNOWN_STD_M,
    UNKNOWN_STD_RAD,
    WHEEL_TURN_STD_RAD,
    CompassTurns,
    measure_turns,
    turns_with_images,
)
from deepgps.diagnosis.diagnosis import apply_diagnosis, can_diagnose, diagnose
from deepgps.diagnosis.gaps import mend_stuck
from deepgps.tracking.motion import NO_MOTION, Motion, compose, make_motion, rotate
from sim.recording.format import Recording
from sim.recording.turns import KINDS, NO_IMAGE
from sim.sensors.encoder import expect_variance

DISTANCE_STD_SHARE = 0.005  # Standard deviation of a distance by the wheels, as a part, beside the errors of encoders
LATERAL_STD_M, HEADING_STD_RAD = 0.002, 0.02
"""Standard deviations of the place beside a straight line and of the heading, after a metre [m], [rad]."""


@dataclass(frozen=True)
class Drive:
    """M images in the order driven."""

    observation: np.ndarray  # Observation of each (M,), or -1: it is an image after a turn
    turn_image: np.ndarray  # Turn image of each (M,), or -1: it is an observation
    reading: np.ndarray  # Row of the recording's readings at each (M,)
    motions: list[Motion | None]  # Motion to each from the one before (M,); None: nothing is known of it
    turns: CompassTurns  # The turns between its segments


class _Node(NamedTuple):
    observation: int
    turn_image: int
    reading: int
    motion: Motion | None


def read_drive(recording: Recording, curvature: float = 0.0) -> Drive:
    """The images of a recording, and the motions between them along straights with a curvature to the left [1 / m].

    Observations to which no reading belongs are left out, and segments of a single reading.
    """
    turns = measure_turns(recording) if turns_with_images(recording) else measure_wheel_turns(recording)
    nodes = _list_nodes(recording, turns, curvature)
    observation, turn_image, reading, motions = zip(*nodes, strict=True)
    return Drive(np.array(observation), np.array(turn_image), np.array(reading), list(motions), turns)


def mend_wheels(recording: Recording) -> tuple[Recording, float]:
    """Take the noise and the track width that a recording's own readings and images show, and mend a stuck wheel.

    Also returns the curvature of what the robot drives for straight, to the left, where it shows [1 / m].
    """
    if not can_diagnose(recording):
        return recording, 0.0
    found = diagnose(recording)
    ratio, curves = found.wheel_ratio, not found.wheel_ratio.low <= 1.0 <= found.wheel_ratio.high
    curvature = 2.0 * (ratio.value - 1.0) / (ratio.value + 1.0) / found.track_m.value
    return apply_diagnosis(mend_stuck(recording), found), curvature if ratio.known and curves else 0.0


def measure_wheel_turns(recording: Recording) -> CompassTurns:
    """The turns between consecutive segments of at least two readings, by the wheels."""
    pose, runs = dead_reckon(recording), [run for run in find_runs(recording) if len(run) >= 2]
    before, after = (pose[[run[end] for run in part]] for part, end in ((runs[:-1], -1), (runs[1:], 0)))
    angle = after[:, 2] - before[:, 2]
    jump = (rotate(-before[:, 2]) @ (after - before)[:, :2, None])[..., 0]
    jump_std = np.where(np.abs(jump).max(axis=1, initial=0.0) > MEETING_STD_M, BACK_OFF_STD_M, MEETING_STD_M)
    unknown = np.zeros(len(angle), bool)
    if recording.turns is not None:
        carried = recording.turns.after[recording.turns.kind == KINDS.index("relocated")]
        unknown |= np.isin([run[0] for run in runs[1:]], carried)
    angle_std = np.where(unknown, UNKNOWN_STD_RAD, WHEEL_TURN_STD_RAD)
    return CompassTurns(angle, angle_std, jump, np.where(unknown, UNKNOWN_STD_M, jump_std))


def find_shared(recording: Recording) -> dict[int, int]:
    """Turns that end at a reading whose image was taken before the turn: their numbers by the rows of the readings."""
    if (turns := recording.turns) is None:
        return {}
    numbers = np.flatnonzero(turns.before == recording.reading[turns.after, 1])
    return dict(zip(turns.after[numbers].tolist(), numbers.tolist(), strict=True))


def _list_nodes(recording: Recording, turns: CompassTurns, curvature: float) -> list[_Node]:
    every, usual_m, shared = find_runs(recording), _find_usual_gap(recording), find_shared(recording)
    numbers = [number for number, run in enumerate(every) if len(run) >= 2]
    nodes, pending = list[_Node](), None
    for row, number in enumerate(numbers):
        _add_segment(nodes, recording, every[number], pending, curvature, usual_m, int(every[number][0]) in shared)
        if row + 1 < len(numbers):
            reading, follows = int(every[numbers[row + 1]][0]), numbers[row + 1] == number + 1
            pending = _add_turn(nodes, recording, turns, row, reading, shared.get(reading) if follows else None)
    return nodes


def _find_usual_gap(recording: Recording) -> float:
    """Median distance between two readings of a segment [m]; 0 where there is none."""
    distance = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    gaps = np.abs(np.diff(distance))[np.diff(recording.reading[:, 0]) == 0]
    return float(np.median(gaps)) if len(gaps) else 0.0


def _add_segment(
    nodes: list[_Node],
    recording: Recording,
    run: np.ndarray,
    pending: Motion | None,
    curvature: float,
    usual_m: float,
    shares: bool,
) -> None:
    """Add the images of a segment of these readings; ``pending`` leads to its first one, None: nothing is known.

    A segment that ``shares`` its first image has that of the last image before the turn. Where that one was not added,
    it is left out here too, since it does not show the heading after the turn.

    Noise that grows with a gap grows with the true one: a gap that was measured too short errs no less than others.
    """
    seen = recording.reading[run, 1].tolist()
    distance, odometry = travel(recording.reading[run, 2:], recording.manifest.odometry), recording.manifest.odometry
    there = bool(nodes) and max(nodes[-1].observation, nodes[-2:][0].observation) == seen[0]
    if not there and not shares:
        nodes.append(_Node(seen[0], NO_IMAGE, int(run[0]), pending))
        pending = NO_MOTION
    for number in range(1, len(run)):
        gap, made_of = distance[number] - distance[number - 1], max(1, seen[number] - seen[number - 1])
        long = max(abs(float(gap.mean())), usual_m)
        ahead = drive_straight(gap, expect_variance(odometry, long, made_of), curvature)
        nodes.append(_Node(seen[number], NO_IMAGE, int(run[number]), pending and compose(pending, ahead)))
        pending = NO_MOTION


def _add_turn(
    nodes: list[_Node], recording: Recording, turns: CompassTurns, row: int, reading: int, number: int | None
) -> Motion | None:
    """Add the images beside turn ``row``; what motion is left to the next segment's first ``reading``, None: unknown.

    ``number`` is that of the recording's turn which ends at the image from before it, with no segment without a way
    between; None: there is none.
    """
    if turns.angle_std[row] >= UNKNOWN_STD_RAD or turns.jump_std[row] >= UNKNOWN_STD_M:
        return None
    jump = make_motion(*turns.jump[row].tolist(), step_std_m=float(turns.jump_std[row]))
    turn = make_motion(0.0, turn_rad=float(turns.angle[row]), turn_std_rad=float(turns.angle_std[row]))
    if number is None or recording.turns is None:
        return compose(jump, turn)
    place = int(recording.turns.before[number])
    if place != nodes[-1].observation:  # the reading before the turn was lost, and the image shows the heading before
        nodes.append(_Node(place, NO_IMAGE, reading, jump))
    if (image := int(recording.turns.image[number])) == NO_IMAGE:
        return turn
    nodes.append(_Node(NO_IMAGE, image, reading, turn))
    return NO_MOTION


def drive_straight(wheels_m: np.ndarray, variance: float, curvature: float = 0.0) -> Motion:
    """The motion along a straight line, or an arc to the left [1 / m], by the distances of both wheels (2,) [m].

    Where these differ, one of them is wrong; the variance is that expected of their mean [m^2].
    """
    distance_m, apart_m = float(wheels_m.mean()), float(np.diff(wheels_m)[0])
    bent, long = curvature * distance_m, abs(distance_m)
    step = distance_m * np.array([np.cos(bent / 2.0), np.sin(bent / 2.0)])
    spread = [
        variance + (DISTANCE_STD_SHARE * distance_m) ** 2 + (apart_m / 2.0) ** 2,
        LATERAL_STD_M**2 * long,
        HEADING_STD_RAD**2 * long,
    ]
    return Motion(step, bent, np.diag(spread))
