"""A drive tracked by a trained method: poses by single images, filter, smoother, and odometry alone.

A path is also written in the TUM format, which ``evo`` and most tools for trajectories read: time x y z qx qy qz qw.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepgps.data.segments import dead_reckon, read_segments
from deepgps.initial_map.distances.dense import find_chirality
from deepgps.positioner.pose import Poses, find_poses
from deepgps.positioner.positioner import Positioner
from deepgps.terminal.progress import Report
from deepgps.tracking.drive import Drive, find_shared, mend_wheels, read_drive
from deepgps.tracking.filter import State, estimate, run_forward, smooth, weigh
from deepgps.tracking.fix import Fix, take_fixes
from deepgps.tracking.motion import Motion, mirror, move, rotate
from sim.files.atomic import write_text
from sim.files.checksums import read_arrays, write_arrays
from sim.recording.format import Recording
from sim.recording.turns import NO_IMAGE

HEAD = "# deepgps: time_s x_m y_m z_m qx qy qz qw"


def write_tum(path: Path, time: np.ndarray, pose: np.ndarray) -> None:
    """Write a path at times (n,) [s]; rows without a time or a position are left out.

    Poses x, y [m], yaw [rad] (n, 3); positions (n, 2) and a yaw of NaN are written with a yaw of zero.
    """
    place = np.asarray(pose, float)
    yaw = np.nan_to_num(place[:, 2]) if place.shape[1] > 2 else np.zeros(len(place))
    zero = np.zeros(len(place))
    table = np.column_stack([time, place[:, :2], zero, zero, zero, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])
    kept = table[np.isfinite(table).all(axis=1)]
    lines = (" ".join([f"{row[0]:.6f}", *(f"{value:.9g}" for value in row[1:])]) for row in kept)
    write_text(path, "\n".join([HEAD, *lines]) + "\n")


def is_tum(data: bytes) -> bool:
    """Whether these are the contents of such a file, which may be written over."""
    return data.startswith(HEAD.encode())


PATHS = {
    "single": "single image",
    "causal": "tracked, causal",
    "smoothed": "tracked, smoothed",
    "odometry": "wheels and compass",
    "dead_reckoning": "wheels alone",
}
"""The paths of a drive and their titles; those by odometry begin at the first image."""
KEPT_HYPOTHESES = 4  # Hypotheses of the filter that are kept at each image


@dataclass(frozen=True)
class TrackedPath:
    """Poses of M images."""

    pose: np.ndarray  # x, y [m], yaw [rad] (M, 3) in the method's frame; NaN where it is unknown
    std: np.ndarray  # Standard deviations of the position along each axis [m] and of the yaw [rad] (M, 2)
    accepted: np.ndarray  # Which are certain enough to be used (M,) bool


@dataclass(frozen=True)
class Track:
    """A tracked drive of M images."""

    observation: np.ndarray  # Observation of each image (M,), or -1: it is an image after a turn
    turn_image: np.ndarray  # Turn image of each (M,), or -1
    time: np.ndarray  # Time of each (M,) [s]
    paths: dict[str, TrackedPath]  # The paths by their names in ``PATHS``
    # The likeliest poses that the filter holds at each image (M, ``KEPT_HYPOTHESES``, 3); NaN where it holds fewer
    hypothesis: np.ndarray
    probability: np.ndarray  # Their probabilities (M, ``KEPT_HYPOTHESES``)


def track_drive(positioner: Positioner, recording: Recording, progress: Report) -> Track:
    """Track the robot through a recording by a method as deployed.

    Raises InputError if no segment has two readings, or no wheel turned.
    """
    progress("track", 0, 4)
    segments = read_segments(recording)
    recording, curvature = mend_wheels(recording)
    drive = read_drive(recording, curvature)
    progress("track", 1, 4)
    poses = find_poses(positioner, recording.observation)
    fixes = _list_fixes(positioner, recording, drive, poses)
    mirrored = positioner.mirrored  # a map may be: a turn to the left is one to the right in it
    if mirrored is None:
        mirrored = find_chirality(poses.position, segments, drive.turns.angle) < 0
    motions = [one and mirror(one) for one in drive.motions] if mirrored else drive.motions
    progress("track", 2, 4)
    causal = run_forward(motions, fixes, positioner.mapped)
    progress("track", 3, 4)
    smoothed = smooth(causal, motions, fixes)
    progress("track", 4, 4)
    # the first image that is accepted and tells a yaw, or else the first one
    number = next((number for number, one in enumerate(fixes) if one.accepted and np.isfinite(one.yaw)), 0)
    first = number, _as_path([fixes[number]]).pose[0]
    paths = {
        "single": _as_path(fixes),
        "causal": _estimate(causal),
        "smoothed": _estimate(smoothed),
        "odometry": _from_poses(_follow(motions, first)),
        "dead_reckoning": _from_poses(_reckon(recording, drive, mirrored, first)),
    }
    hypothesis, probability = _list_hypotheses(causal)
    return Track(drive.observation, drive.turn_image, _stamp(recording, drive), paths, hypothesis, probability)


def write_track(path: Path, track: Track) -> None:
    """Write a track as ``.npz``."""
    arrays = {name: value for name, value in vars(track).items() if name != "paths"}
    arrays |= {f"{name}/{part}": value for name, one in track.paths.items() for part, value in vars(one).items()}
    write_arrays(path, arrays)


def read_track(path: Path) -> Track:
    """Read a track; raises DamagedError where the file differs from its checksums."""
    arrays = read_arrays(path)
    paths = {
        name: TrackedPath(*(arrays.pop(f"{name}/{part}") for part in ("pose", "std", "accepted"))) for name in PATHS
    }
    return Track(paths=paths, **arrays)


def _list_fixes(positioner: Positioner, recording: Recording, drive: Drive, poses: Poses) -> list[Fix]:
    fixes = take_fixes(poses)
    seen = drive.turn_image[drive.turn_image != NO_IMAGE]
    after = dict[int, Fix]()
    if len(seen):
        assert recording.turn_observation is not None
        found = take_fixes(find_poses(positioner, recording.turn_observation[seen]))
        after = dict(zip(seen.tolist(), found, strict=True))
    both = zip(drive.observation.tolist(), drive.turn_image.tolist(), strict=True)
    return [after[image] if observation == NO_IMAGE else fixes[observation] for observation, image in both]


def _as_path(fixes: Sequence[Fix]) -> TrackedPath:
    pose = np.array([[*one.position, one.yaw] for one in fixes])
    std = np.array([[one.position_std, one.yaw_std] for one in fixes])
    return TrackedPath(pose, std, np.array([one.accepted for one in fixes], bool))


def _estimate(states: Sequence[State]) -> TrackedPath:
    rows = [([*one.position, one.yaw], [one.position_std, one.yaw_std], one.accepted) for one in map(estimate, states)]
    pose, std, accepted = zip(*rows, strict=True)
    return TrackedPath(np.array(pose), np.array(std), np.array(accepted))


def _from_poses(pose: np.ndarray) -> TrackedPath:
    return TrackedPath(pose, np.full((len(pose), 2), np.nan), np.asarray(np.isfinite(pose).all(axis=1)))


def _follow(motions: Sequence[Motion | None], first: tuple[int, np.ndarray]) -> np.ndarray:
    """Poses (M, 3) by motions alone from the pose of the first image on; NaN before it, and where none is known."""
    number, pose = first
    found, at, covariance = np.full((len(motions), 3), np.nan), np.append(pose, 0.0)[None], np.zeros((1, 4, 4))
    for row in range(number, len(motions)):
        if row > number:
            motion = motions[row]
            if motion is None:
                break
            at, _ = move(at, covariance, motion)
        found[row] = at[0, :3]
    return found


def _reckon(recording: Recording, drive: Drive, mirrored: bool, first: tuple[int, np.ndarray]) -> np.ndarray:
    """Poses (M, 3) by the wheels alone, from the pose of the first image on."""
    number, pose = first
    every = dead_reckon(recording)
    path = every[drive.reading]
    early = np.isin(drive.reading, list(find_shared(recording))) & (drive.observation != NO_IMAGE)
    path[early, 2] = every[drive.reading[early] - 1, 2]  # the image is from before the turn that ends at its reading
    path[:, 1:] *= -1.0 if mirrored else 1.0
    turn = rotate(np.array(pose[2] - path[number, 2]))
    found = np.column_stack([pose[:2] + (path - path[number])[:, :2] @ turn.T, path[:, 2] + pose[2] - path[number, 2]])
    found[:number] = np.nan
    return found


def _list_hypotheses(states: Sequence[State]) -> tuple[np.ndarray, np.ndarray]:
    probability = np.zeros((len(states), KEPT_HYPOTHESES))
    hypothesis = np.full((*probability.shape, 3), np.nan)
    for row, state in enumerate(states):
        weight = weigh(state)
        order = np.argsort(-weight, kind="stable")[:KEPT_HYPOTHESES]
        hypothesis[row, : len(order)], probability[row, : len(order)] = state.mean[order, :3], weight[order]
    return hypothesis, probability


def _stamp(recording: Recording, drive: Drive) -> np.ndarray:
    """Times of the images (M,) [s]; one after a turn is taken as midway between its neighbours."""
    assert recording.observation_time is not None
    time = np.where(drive.observation == NO_IMAGE, np.nan, recording.observation_time[drive.observation])
    known = np.isfinite(time)
    rows = np.arange(len(time))
    return np.interp(rows, rows[known], time[known]) if known.any() else time
