"""A recording's motions: with the true readings they are the true path, whatever is lost, stuck or mirrored."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.data.segments import find_runs
from deepgps.tracking.drive import drive_straight, mend_wheels, read_drive
from deepgps.tracking.motion import Motion, move
from deepgps.tracking.track import _follow, _reckon
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import KINDS, NO_IMAGE, lose_turns


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


def lose(recording: Recording, kept: np.ndarray) -> Recording:
    assert recording.turns is not None
    turns = lose_turns(recording.turns, recording.reading[:, 0], kept)
    return replace(recording, reading=recording.reading[kept], time=recording.time[kept], turns=turns)


def check_ways(recording: Recording) -> None:
    """Ways between images are the true ones, by their length, which no heading changes."""
    drive, true = read_drive(recording), open_truth(recording.folder).pose
    seen = -1
    pending: Motion | None = None
    for observation, motion in zip(drive.observation.tolist(), drive.motions, strict=True):
        if observation == NO_IMAGE:
            pending = motion
        elif seen >= 0 and motion is not None:
            distance = np.hypot(*(true[observation] - true[seen])[:2])
            allowed = 0.005 + 3.0 * np.sqrt(np.trace(motion.covariance[:2, :2]))
            assert abs(motion.length_m - distance) < allowed, (seen, observation, pending)
        seen = max(seen, observation)


def test_every_observation_is_there_once(recording: Recording):
    drive = read_drive(recording)
    seen = drive.observation[drive.observation != NO_IMAGE]
    assert seen.tolist() == sorted(set(recording.reading[:, 1].tolist()))
    assert ((drive.observation == NO_IMAGE) != (drive.turn_image == NO_IMAGE)).all()
    assert [one is None for one in drive.motions] == [True] + [False] * (len(drive.motions) - 1)


def test_motions_lead_along_the_true_path(recording: Recording):
    drive, true = read_drive(recording), open_truth(recording.folder).pose
    at, covariance = np.append(true[drive.observation[0]], 0.0)[None], np.zeros((1, 4, 4))
    worst = 0.0
    for observation, motion in zip(drive.observation[1:40], drive.motions[1:40], strict=True):
        assert motion is not None
        at, covariance = move(at, covariance, motion)
        if observation != NO_IMAGE:
            away = at[0, :2] - true[observation, :2]
            worst = max(worst, float(np.hypot(*away) / np.sqrt(np.trace(covariance[0, :2, :2]) + 1e-6)))
    assert worst < 3.0


def test_ways_are_right_where_readings_are_lost(recording: Recording):
    check_ways(recording)
    for seed in range(2):
        check_ways(lose(recording, np.random.default_rng(seed).random(len(recording.reading)) > 0.3))


def test_every_image_has_the_heading_with_which_it_was_taken(recording: Recording):
    true = open_truth(recording.folder).pose
    for lost in (0.0, 0.1, 0.3):
        kept = np.random.default_rng(1).random(len(recording.reading)) >= lost
        some = lose(recording, kept)
        drive = read_drive(some)
        first = (0, true[drive.observation[0]])
        seen = drive.observation != NO_IMAGE
        for path in (_follow(drive.motions, first), _reckon(some, drive, False, first)):
            error = wrap(path[seen, 2] - true[drive.observation[seen], 2])
            assert np.nanmax(np.abs(error)) < np.radians(15.0), "32 sectors are 11 degrees each; turns are larger"


def test_relocated_robot_moves_nobody_knows_how(recording: Recording):
    assert recording.turns is not None
    kind = recording.turns.kind.copy()
    kind[3] = KINDS.index("relocated")
    for turns in (replace(recording.turns, kind=kind), None):
        drive = read_drive(replace(recording, turns=turns))
        assert sum(one is None for one in drive.motions) == (1 if turns is None else 2)


def test_without_images_of_turns_the_wheels_turn(recording: Recording):
    drive = read_drive(replace(recording, turns=None, turn_observation=None))
    assert (drive.turn_image == NO_IMAGE).all()
    assert sum(abs(one.turn) > 0.3 for one in drive.motions if one) > 5


def test_wheel_that_is_stuck_makes_the_way_uncertain():
    right = drive_straight(np.array([0.1, 0.1]), 0.0)
    stuck = drive_straight(np.array([0.1, 0.0]), 0.0)
    assert np.sqrt(right.covariance[0, 0]) < 0.001
    assert np.sqrt(stuck.covariance[0, 0]) == pytest.approx(0.05, rel=0.01), "the way may be 10 cm as well as 0"


def test_gap_that_was_measured_too_short_errs_no_less_than_others(recording: Recording):
    """Noise is a part of the true gap: where the measured one is nearly zero, it is the noise that made it so."""
    reading = recording.reading.copy()
    run = next(run for run in find_runs(recording) if len(run) >= 6)
    reading[run[3] :, 2:] -= reading[run[3], 2:] - reading[run[2], 2:]  # no tick from the third to the fourth
    odometry = {**recording.manifest.odometry, "step_noise": 0.3}
    noisy = recording.manifest.model_copy(update={"odometry": odometry})
    drive = read_drive(replace(recording, reading=reading, manifest=noisy))
    motions = [one for one in drive.motions if one and one.turn == 0.0]
    spread = [float(np.sqrt(one.covariance[0, 0])) for one in motions if one.length_m < 0.001]
    assert spread
    assert min(spread) > 0.2 * float(np.median([one.length_m for one in motions]))


def test_arc_has_its_chord():
    motion = drive_straight(np.array([1.0, 1.0]), 0.0, curvature=0.2)
    chord = 2.0 / 0.2 * np.sin(0.1)
    assert motion.turn == pytest.approx(0.2)
    assert motion.length_m == pytest.approx(chord, rel=0.01)
    assert np.arctan2(*motion.step[::-1]) == pytest.approx(0.1)


def test_wheels_without_turns_stay_as_they_are(recording: Recording):
    bare = replace(recording, turns=None, turn_observation=None)
    mended, curvature = mend_wheels(bare)
    assert mended is bare
    assert curvature == 0.0
