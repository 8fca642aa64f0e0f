"""A trained method of a run tracks the robot through the drive in use, or through another recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.data.checks import check_recording, check_view, find_view
from deepgps.diagnosis.store import digest_files
from deepgps.evaluation.in_use import adapt, find_causes, open_drive_in_use
from deepgps.evaluation.stored_alignment import has_alignment, read_alignment
from deepgps.evaluation.track_errors import measure_track, take_in_world
from deepgps.learning.trainer import find_device, use_threads
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.runs.owned_folder import hold
from deepgps.runs.run_folder import RUN, list_trained, open_run
from deepgps.terminal.progress import Report
from deepgps.tracking.track import Track, is_tum, track_drive, write_track, write_tum
from sim.alignment import Alignment
from sim.errors import InputError, quote
from sim.files.atomic import check_overwrite
from sim.files.checksums import write_json
from sim.geometry import FreeSpace
from sim.recording.format import Recording, has_truth, open_recording, open_truth
from sim.recording.turns import NO_IMAGE

FOLDER = "tracking"
"""Folder of tracked drives in a run's folder."""


@dataclass(frozen=True)
class Reference:
    """Where the robot truly was.

    Attributes:
        alignment: From the method's frame to the world's.
        pose: True pose of each image (M, 3); NaN for images after turns.
        space: Where the robot fits.
    """

    alignment: Alignment
    pose: np.ndarray
    space: FreeSpace


@dataclass(frozen=True)
class Tracked:
    """A tracked drive of a run.

    Attributes:
        method: Name of the method.
        path: Path of its files, without their suffix.
        track: The track.
        figures: Contents of its ``.json``.
        alignment: From the method's frame to the world's; None: evaluation has not placed the map there.
        start_s: The log's time of the track's time 0 [s since 1970]; 0 for a drive that comes from no log.
        reference: The truth; None: it is not known.
    """

    method: str
    path: Path
    track: Track
    figures: dict[str, Any]
    alignment: Alignment | None
    start_s: float
    reference: Reference | None


def track_run(run: Path, method: str | None, drive: Path | None, progress: Report) -> Tracked:
    """Track the robot, and write ``tracking/<method>.npz`` and ``.json`` in the run's folder.

    Args:
        run: The run's folder.
        method: A trained method; None: the first of the run.
        drive: Folder of a recording; None: the drive in use.
        progress: Called with the steps done.

    Raises:
        InputError: The folder is no run, is in use, has no such method or no drive in use, or the truth of both drives
            is known but the run has not been evaluated.
    """
    scenario = open_run(run)
    with hold(run, RUN, "the run"):
        return _track_held(run, scenario, method, drive, progress)


def _track_held(run: Path, scenario: Scenario, method: str | None, drive: Path | None, progress: Report) -> Tracked:
    name = _choose(run, scenario.methods, method)
    recording, path = _open_drive(run, drive, name)
    alignment = _find_alignment(folder_of(run, name), recording)
    device = find_device(scenario.learn.train.device)
    with use_threads(scenario.learn.train.threads):
        trained = load_positioner(folder_of(run, name), device)
        positioner, _ = adapt(trained, recording)
        track = track_drive(positioner, recording, progress)
        causes = find_causes(trained, open_recording(run / "recording"), recording)
    known = alignment is not None and has_truth(recording.folder)
    reference = _open_reference(alignment, recording, track) if alignment and known else None
    figures = {**_describe(name, len(recording.observation), track, reference), **causes}
    write_track(path.with_suffix(".npz"), track)
    write_json(path.with_suffix(".json"), figures)
    return Tracked(name, path, track, figures, alignment, 1e-9 * recording.manifest.start_ns, reference)


def write_tums(folder: Path, tracked: Tracked) -> list[Path]:
    """Write each path, and the truth if it is known, as TUM files, by the log's own time where there is a log.

    Poses are in the world's frame if evaluation has placed the map there, else in the map's own.

    Raises:
        InputError: A file of such a name is there that deepgps did not write.
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
    recording = open_drive_in_use(open_recording(run / "recording"))
    if recording is None:
        raise InputError(
            f"{run} has no drive in use, which --deployment.drive-samples makes; or name the folder of a recording"
        )
    return recording, run / FOLDER / method


def _find_alignment(folder: Path, recording: Recording) -> Alignment | None:
    """The alignment of a method's map with the world; None: there is none.

    Raises:
        InputError: There should be one, since the truth of this drive and that of training are known.
    """
    wanted = has_truth(recording.folder) and has_truth(folder.parent / "recording")
    return read_alignment(folder) if wanted or has_alignment(folder) else None


def _open_reference(alignment: Alignment, recording: Recording, track: Track) -> Reference:
    truth = open_truth(recording.folder)
    if len(truth.pose) != len(recording.observation):
        raise InputError(
            f"{recording.folder}: it has {len(recording.observation)} observations, but the truth {len(truth.pose)}"
        )
    pose = np.where((track.observation != NO_IMAGE)[:, None], truth.pose[track.observation], np.nan)
    return Reference(alignment, pose, truth.free_space)


def _describe(method: str, images: int, track: Track, reference: Reference | None) -> dict[str, Any]:
    seen = track.observation != NO_IMAGE
    figures = {
        "method": method,
        "images": images,
        "tracked": int(seen.sum()),
        "accepted": {name: float(track.paths[name].accepted[seen].mean()) for name in ("single", "causal", "smoothed")},
    }
    if reference is None:
        return figures
    return {**figures, "paths": measure_track(track, reference.alignment, reference.pose)}
