"""A trained method of a run tracks the robot through the deployment drive, or through another recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.config.methods import folder_of
from deepgps.data.checks import check_recording, check_view, find_view
from deepgps.diagnosis.store import digest_files
from deepgps.evaluation.deployment import adapt, find_causes, open_deployment
from deepgps.evaluation.error_field import find_rms
from deepgps.evaluation.stored_alignment import has_alignment, read_alignment
from deepgps.learning.trainer import find_device, use_threads
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.runs.owned_folder import hold
from deepgps.runs.run_folder import RUN, drop_viewed, list_trained, open_run
from deepgps.terminal.progress import Report
from deepgps.tracking.motion import rotate
from deepgps.tracking.track import Track, TrackedPath, is_tum, track_drive, write_track, write_tum
from sim.alignment import Alignment, fit_alignment
from sim.errors import InputError, quote
from sim.files.atomic import check_overwrite
from sim.files.checksums import write_json
from sim.geometry import FreeSpace, wrap
from sim.recording.format import Recording, has_truth, open_recording, open_truth
from sim.recording.turns import NO_IMAGE

FOLDER = "tracking"  # Folder of tracked drives in a run's folder


@dataclass(frozen=True)
class Reference:
    """Where the robot truly was."""

    alignment: Alignment  # From the method's frame to the world's
    pose: np.ndarray  # True pose of each image (M, 3); NaN for images after turns
    space: FreeSpace  # Where the robot fits


@dataclass(frozen=True)
class Tracked:
    """A tracked drive of a run."""

    method: str  # Name of the method
    path: Path  # Path of its files, without their suffix
    track: Track  # The track
    figures: dict[str, Any]  # Contents of its ``.json``
    alignment: Alignment | None  # From the method's frame to the world's; None: evaluation has not placed the map there
    start_s: float  # The log's time of the track's time 0 [s since 1970]; 0 for a drive that comes from no log
    reference: Reference | None  # The truth; None: it is not known


def track_run(run: Path, method: str | None, drive: Path | None, progress: Report) -> Tracked:
    """Track the robot, and write ``tracking/<method>.npz`` and ``.json`` in the run's folder.

    By default the method is the first of the run, and the drive that of deployment. Raises InputError if the folder is
    no run, is in use, has no such method or no deployment drive, or the truth of both drives is known but it is not
    evaluated.
    """
    scenario = open_run(run)
    with hold(run, RUN, "the run"):
        name = _choose(run, scenario.methods, method)
        recording, path = _open_drive(run, drive, name)
        # there should be one where the truth of this drive and that of training are known
        wanted, folder = has_truth(recording.folder) and has_truth(run / "recording"), folder_of(run, name)
        alignment = read_alignment(folder) if wanted or has_alignment(folder) else None
        with use_threads(scenario.learn.train.threads):
            trained = load_positioner(folder, find_device(scenario.learn.train.device))
            positioner, _ = adapt(trained, recording)
            track = track_drive(positioner, recording, progress)
            causes = find_causes(trained, open_recording(run / "recording"), recording)
        known = alignment if has_truth(recording.folder) else None
        reference = None if known is None else _open_reference(known, recording, track)
        figures = {**_describe(name, len(recording.observation), track, reference), **causes}
        drop_viewed(run)
        write_track(path.with_suffix(".npz"), track)
        write_json(path.with_suffix(".json"), figures)
    return Tracked(name, path, track, figures, alignment, 1e-9 * recording.manifest.start_ns, reference)


def write_tums(folder: Path, tracked: Tracked) -> list[Path]:
    """Write each path, and the truth if it is known, as TUM files, by the log's own time where there is a log.

    Poses are in the world's frame if evaluation has placed the map there, else in the map's own. Raises InputError if a
    file of such a name is there that deepgps did not write.
    """
    track, alignment = tracked.track, tracked.alignment
    poses = {
        name: path.pose if alignment is None else take_in_world(path, alignment) for name, path in track.paths.items()
    }
    if tracked.reference is not None:
        poses["truth"] = tracked.reference.pose
    paths = [folder / f"{name}.tum" for name in poses]
    for path in paths:
        check_overwrite(path, is_tum)
    seen = track.observation != NO_IMAGE
    for path, pose in zip(paths, poses.values(), strict=True):
        write_tum(path, tracked.start_s + track.time[seen], pose[seen])
    return paths


def _choose(run: Path, methods: tuple[str, ...], method: str | None) -> str:
    trained = list_trained(run)
    names = [name for name in methods if name in trained]
    if not names:
        raise InputError(f"{run} holds no trained method")
    if method is not None and method not in names:
        raise InputError(f"--method {quote(method)}: {run} has trained {', '.join(names)}")
    return method or names[0]


def _open_drive(run: Path, drive: Path | None, method: str) -> tuple[Recording, Path]:
    """What the robot sensed, and where its track is written, without a suffix."""
    if drive is not None:
        recording = open_recording(drive)
        check_recording(recording)
        if (view_deg := find_view(recording)) is not None:
            check_view(view_deg, find_view(open_recording(run / "recording")))
        return recording, run / FOLDER / f"{method}-{digest_files(recording)[:8]}"
    recording = open_deployment(open_recording(run / "recording"))
    if recording is None:
        raise InputError(
            f"{run} has no deployment drive, which --deployment.drive-samples makes; or name the folder of a recording"
        )
    return recording, run / FOLDER / method


def _open_reference(alignment: Alignment, recording: Recording, track: Track) -> Reference:
    truth = open_truth(recording.folder)
    pose = np.where((track.observation != NO_IMAGE)[:, None], truth.pose[track.observation], np.nan)
    return Reference(alignment, pose, truth.free_space)


def _describe(method: str, images: int, track: Track, reference: Reference | None) -> dict[str, Any]:
    seen = track.observation != NO_IMAGE
    figures = {
        "method": method,  # Its name
        "images": images,  # Images of the drive
        "tracked": int(seen.sum()),  # Images that were tracked
        # Share of these that is accepted, by path
        "accepted": {name: float(track.paths[name].accepted[seen].mean()) for name in ("single", "causal", "smoothed")},
    }
    if reference is None:
        return figures
    # Errors of each path, where the truth is known
    return {**figures, "paths": measure_track(track, reference.alignment, reference.pose)}


def measure_ate(found: np.ndarray, true: np.ndarray) -> float:
    """Absolute trajectory error [m]: RMS distance of positions (n, 2) [m] after their own rigid alignment."""
    aligned = fit_alignment(found, true, "SE2").apply(found)
    return float(np.sqrt(np.square(aligned - true).sum(axis=1).mean()))


def measure_rpe(found: np.ndarray, true: np.ndarray, apart: int) -> tuple[float, float]:
    """Relative pose error of the way [m] and of the turn [rad], of poses x, y [m], yaw [rad] (n, 3), found and true.

    It is the RMS of the errors of all motions between poses that are so many images apart. A motion of which a yaw is
    NaN does not count; NaN if none is left.
    """
    (way, turn), (true_way, true_turn) = (_find_motions(pose, apart) for pose in (found, true))
    known = np.isfinite(turn)
    if not known.any():
        return np.nan, np.nan
    place = np.sqrt(np.square(way - true_way)[known].sum(axis=1).mean())
    return float(place), float(np.sqrt(np.square(wrap(turn - true_turn)[known]).mean()))


def _find_motions(pose: np.ndarray, apart: int) -> tuple[np.ndarray, np.ndarray]:
    """Ways (n - apart, 2) [m] in the frame of the first pose of each, and turns [rad]."""
    away = pose[apart:] - pose[:-apart]
    return (rotate(-pose[:-apart, 2]) @ away[:, :2, None])[..., 0], away[:, 2]


POSE_SEPARATION = 10  # Images between the two poses of a relative error


def measure_track(track: Track, alignment: Alignment, true: np.ndarray) -> dict[str, dict[str, float]]:
    """Errors of each path at observations with true poses (M, 3); where it tells nothing, they are left out."""
    seen = track.observation != NO_IMAGE
    return {
        name: _measure(take_in_world(path, alignment)[seen], true[seen], path.accepted[seen])
        for name, path in track.paths.items()
    }


def take_in_world(path: TrackedPath, alignment: Alignment) -> np.ndarray:
    """Poses of a path in the world's frame (M, 3)."""
    return np.column_stack([alignment.apply(path.pose[:, :2]), alignment.turn(path.pose[:, 2])])


def measure_distances(path: TrackedPath, alignment: Alignment, true: np.ndarray) -> np.ndarray:
    """Errors of positions of a path (M,) [m], given the true poses of its images (M, 3)."""
    return np.hypot(*(take_in_world(path, alignment) - true)[:, :2].T)


def _measure(found: np.ndarray, true: np.ndarray, accepted: np.ndarray) -> dict[str, float]:
    known = np.isfinite(found[:, :2]).all(axis=1)
    found, true, accepted = found[known], true[known], accepted[known]
    if not len(found):
        return {"images": 0}
    error = np.hypot(*(found - true)[:, :2].T)
    figures = {
        "images": len(found),  # Images with a position
        "rms_m": find_rms(error),  # Errors of positions [m], by the stored alignment
        "median_m": float(np.median(error)),  # Errors of positions [m], by the stored alignment
        "p95_m": float(np.percentile(error, 95.0)),  # Errors of positions [m], by the stored alignment
        "max_m": float(error.max()),  # Errors of positions [m], by the stored alignment
        "ate_m": measure_ate(found[:, :2], true[:, :2]),  # RMS error after an alignment of its own [m]
        "accepted": float(accepted.mean()),  # Share of the poses that are accepted
    }
    if accepted.any():
        # RMS and largest error of what is accepted [m]
        figures |= {"rms_accepted_m": find_rms(error[accepted]), "max_accepted_m": float(error[accepted].max())}
    directed = np.isfinite(found[:, 2])
    if directed.any():
        # RMS error of the yaw [deg]
        figures["yaw_rms_deg"] = float(np.degrees(find_rms(wrap(found[:, 2] - true[:, 2])[directed])))
    place_m, turn_rad = measure_rpe(found, true, POSE_SEPARATION) if len(found) > POSE_SEPARATION else (np.nan, np.nan)
    if np.isfinite(place_m):
        figures["rpe_m"], figures["rpe_deg"] = place_m, float(np.degrees(turn_rad))
    return figures
