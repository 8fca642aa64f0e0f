"""The recording of a run without truth, as of a real robot: what was sensed, the dead-reckoned path, and the maps.

Nothing here is an error: each map is in a frame of its own.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.data.segments import dead_reckon, travel
from deepgps.diagnosis.store import FILE as DIAGNOSIS
from deepgps.evaluation.without_truth import read_judged
from deepgps.reports import run_figures
from deepgps.reports.without_truth import markdown
from deepgps.runs.run_folder import WITHOUT_TRUTH
from deepgps.viewer.run.drive import LEG, RECKONED, find_pictures, log_diagnosis, log_images, log_path, log_ticks
from deepgps.viewer.run.layout import camera_views, diagnosis_view, loss_view, ticks_view
from deepgps.viewer.run.training import log_loss, log_points, loss_rows, snapshot_rows
from deepgps.viewer.save import hash_files, save_recording
from deepgps.viewer.timeline import PROGRESS, drive_clock, put_text, send_series, until_now
from deepgps.viewer.views import aim_eye_at, arrange, series_view, text_view
from sim.recording.format import Recording, open_recording

NOTE = (
    "This recording has no ground truth, so there is no error field. *Drive* plays the sensor data and the "
    "dead-reckoned path; *Training* shows how each method's map unfolds, each in a frame of its own."
)


def write_without_truth(run: Path, path: Path) -> Path:
    """Write the recording of a run without truth to a path.

    Raises:
        InputError: The folder holds no finished recording.
    """
    recording = open_recording(run / "recording")
    reckoned = dead_reckon(recording)[:, :2]
    histories = run_figures.read_histories(run)

    def log(stream: rr.RecordingStream) -> None:
        _log_drive(stream, recording, reckoned)
        for name, history in histories.items():
            log_loss(stream, name, history, loss_rows(history))
            snapshot = history["snapshot"].astype(float)
            log_points(stream, f"map/{name}", snapshot[-1], snapshot, snapshot_rows(history))
        log_diagnosis(stream, run)
        known = markdown(run) if read_judged(run) else ""
        put_text(stream, "report", f"{NOTE}\n\n{known}")

    last = {name: history["snapshot"][-1] for name, history in histories.items()}
    shown = [
        run / "recording" / "manifest.json",
        *sorted(run.glob("*/history.npz")),
        *run.glob(DIAGNOSIS),
        *run.glob(WITHOUT_TRUTH),
    ]
    blueprint = _make_blueprint(recording, reckoned, last)
    save_recording(path, hash_files(run, shown), f"{run.name}, without truth", blueprint, log)
    return path


def _log_drive(stream: rr.RecordingStream, recording: Recording, reckoned: np.ndarray) -> None:
    clock, segment = drive_clock(recording), recording.reading[:, 0]
    log_path(stream, "world/reckoned", segment, reckoned, (RECKONED, LEG), recording.time, clock)
    distance = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    send_series(stream, "drive/distance/encoder", clock(recording.time), distance, "by encoder", RECKONED)
    log_ticks(stream, recording)
    log_images(stream, recording)


def _make_blueprint(recording: Recording, reckoned: np.ndarray, last: Mapping[str, np.ndarray]) -> rrb.Blueprint:
    """The viewer's layout for a recording with its dead-reckoned path (R, 2) and the methods' last maps (n, 2)."""
    drive_s = float(recording.time[-1] - recording.time[0])
    path = rrb.Spatial3DView(
        name="Dead-reckoned path",
        origin="world",
        eye_controls=_aim_at(reckoned),
        overrides={"world/reckoned/path": rrb.VisibleTimeRanges(until_now())},
    )
    beside = rrb.Vertical(
        *camera_views(find_pictures(recording)),
        series_view("Distance travelled [m]", "drive/distance"),
        ticks_view(drive_s),
        rrb.Tabs(text_view("Without truth", "report"), diagnosis_view()),
    )
    tabs: list[rrb.Horizontal | rrb.Vertical] = [rrb.Horizontal(path, beside, name="Drive", column_shares=[3, 2])]
    if last:
        maps = [
            rrb.Spatial3DView(name=title_of(name), origin=f"map/{name}", eye_controls=_aim_at(points, len(last)))
            for name, points in last.items()
        ]
        losses = [loss_view(name) for name in last]
        tabs.append(rrb.Vertical(rrb.Horizontal(*maps), rrb.Horizontal(*losses), name="Training", row_shares=[3, 1]))
    return arrange(tabs, rrb.TimePanel(state="collapsed", timeline=PROGRESS, play_state="following"))


def _aim_at(points: np.ndarray, views: int = 1) -> rrb.EyeControls3D:
    """Place the eye so that points (n, 2) [m] are seen from above in one of several views side by side."""
    return aim_eye_at(points.min(axis=0), points.max(axis=0), reach=max(1.2, 0.55 * views))
