"""A run's drives for evo and other tools: the truth and each method's positions, as TUM files."""

from pathlib import Path

import numpy as np

from deepgps.api.run import Frame, Run
from deepgps.evaluation.deployment import adapt, open_deployment
from deepgps.learning.trainer import use_threads
from deepgps.positioner.pose import find_poses
from deepgps.terminal.progress import Report
from deepgps.tracking.track import write_tum
from sim.errors import InputError
from sim.recording.format import has_truth, open_truth


def write_trajectories(folder: Path, run: Run, method: str | None, frame: Frame | None, progress: Report) -> None:
    """Write ``<drive>/<method>.tum`` of a method, or of all, along the training drive and the deployment drive, and
    ``truth.tum`` beside them where it is known.

    Without a frame, the methods' is the world's where evaluation has placed the map; the truth is in the world's.
    Raises InputError if there is no such method, the recording has no times, or a map has no place in the world.
    """
    methods, deployment = run.methods if method is None else (run.choose(method),), open_deployment(run.recording)
    to_frame = {name: run.alignment(name, frame or run.choose_frame(name)) for name in methods}
    start_s = 1e-9 * run.recording.manifest.start_ns  # all drives of a log count from its start
    drives = {"training": run.recording} | ({} if deployment is None else {"use": deployment})
    for drive, recording in drives.items():
        if recording.observation_time is None or not np.isfinite(recording.observation_time).any():
            raise InputError(f"{recording.folder} has no times of its observations, which a trajectory needs")
        order = np.argsort(recording.observation_time, kind="stable")
        time_s = start_s + recording.observation_time[order]
        if has_truth(recording.folder):
            write_tum(folder / drive / "truth.tum", time_s, open_truth(recording.folder).pose[order])
        for number, name in enumerate(methods):
            progress(f"trajectories, {drive}", number, len(methods))
            positioner, alignment = run.positioner(name), to_frame[name]
            if drive == "use":
                positioner, _ = adapt(positioner, recording)  # the lean in deployment is corrected as in evaluation
            with use_threads(run.scenario.learn.train.threads):
                poses = find_poses(positioner, recording.observation)
            poses = poses if alignment is None else poses.align(alignment)
            path = poses.position if poses.yaw is None else np.column_stack([poses.position, poses.yaw])
            write_tum(folder / drive / f"{name}.tum", time_s, path[order])
        progress(f"trajectories, {drive}", len(methods), len(methods))
