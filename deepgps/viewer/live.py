"""Showing a run in progress: a thread sends to a viewer what the stages report and write, each part as far as it goes.

The stages know nothing of this thread: it receives the reports for the progress bars and the history of a training now
and then, and reads the files in the run folder. Whatever happens to the viewer, the run continues. The functions that
log a finished run log each part. All rows are on one timeline, ``run_time`` [s], which starts with the view; new rows
are spread over the time since the last update, so that they play back smoothly.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.config.methods import title_of
from deepgps.config.scenario import Scenario
from deepgps.evaluation.error_field import read_all_headings
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from deepgps.runs.run_folder import METRICS
from deepgps.terminal.progress import Look, Report
from deepgps.viewer import drive, layout
from deepgps.viewer.connect import LOST_VIEWER_ERRORS, connect
from deepgps.viewer.making import History, log_loss, log_snapshots
from deepgps.viewer.own_map import log_own_map, tell_unseen
from deepgps.viewer.pictures import POLAR_PICTURES, log_polar
from deepgps.viewer.run import log_results
from deepgps.viewer.scene import log_room
from deepgps.viewer.stream import RUN_TIME, put_text, run_clock
from sim.errors import DamagedError, one_line
from sim.files.checksums import read_arrays
from sim.geometry import limits
from sim.recording.format import Truth, chunk_files, has_truth, open_recording, open_truth, work_folder
from sim.settings import CameraSettings

APPLICATION = "deepgps live"  # not that of recordings, whose blueprint it would replace
PERIOD_S = 1.0
STALL_S = 10.0  # How long a viewer may accept no data [s]
PATIENCE_S = 20.0  # How long a finished run waits for a slow viewer to accept the remaining data [s]
Spread = Callable[[int], np.ndarray]
"""Makes times (n,) [s] for so many rows, spread over the time since the last update."""
TRACK_M = 0.16  # Distance between the wheels of the robot that is drawn until its own is known
PICTURE_STRIDE = 32  # observations
PICTURE_BATCH = 100


@contextmanager
def show_live(
    address: str, scenario: Scenario, folder: Path, progress: Report, warn: Callable[[str], None]
) -> Iterator[Report]:
    """Stream a run to a viewer while it runs; yields the progress report for its stages to call.

    The address is host:port or a Rerun URL; without one, a viewer is opened, which stays open. ``warn`` is called with
    one line when the viewer stops answering. Raises InputError if no viewer answers, WorkError if none can be opened.
    """
    by_hand = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))  # each update flushes
    stream = connect(address, APPLICATION, by_hand)
    view = LiveView(stream, scenario, folder)
    ended, lost, heard = threading.Event(), threading.Event(), 0.0
    thread = threading.Thread(target=_send, args=(stream, view, ended, lost, warn), daemon=True)

    def begin() -> None:
        if thread.ident is None:
            thread.start()

    def report(label: str, done: int, total: int, look: Look | None = None) -> None:
        nonlocal heard
        progress(label, done, total, look)
        view.steps[label] = (done, total)
        if look is not None and (time.monotonic() - heard >= PERIOD_S or done == total):
            view.histories[label], heard = look(), time.monotonic()
        begin()  # not before: the folder may hold another run, which is replaced or refused

    try:
        yield report
        begin()  # the stages of a finished run report nothing
    finally:
        ended.set()
        if thread.ident is None:
            stream.disconnect()
        else:
            thread.join(PATIENCE_S)
        if thread.is_alive():
            if not lost.is_set():
                warn("the viewer no longer accepts data; it does not show the complete run")
            rr.unregister_shutdown()  # when the process exits, it would wait forever for the viewer


def _send(
    stream: rr.RecordingStream,
    view: "LiveView",
    ended: threading.Event,
    lost: threading.Event,
    warn: Callable[[str], None],
) -> None:
    """Send new data every ``PERIOD_S``, and a last time when the run has ended."""
    last = False
    try:
        while not last:
            last = ended.wait(PERIOD_S)
            view.update()
            stream.flush(timeout_sec=STALL_S)
    except Exception as error:  # a bug in the live view must not end the run
        what = (
            "the connection to the viewer is lost" if isinstance(error, LOST_VIEWER_ERRORS) else "the live view failed"
        )
        lost.set()
        warn(f"{what} ({type(error).__name__}: {one_line(error)}); the run continues without it")
    finally:
        stream.disconnect()  # never returns if the viewer hangs


class LiveDrive:
    """Sends a drive to the viewer, from the chunks that make up a recording, and keeps track of what has been sent."""

    def __init__(self, stream: rr.RecordingStream, folder: Path, camera: CameraSettings) -> None:
        self.stream, self.work, self.camera = stream, work_folder(folder), camera
        self.chunks = self.pictures = self.observations = self.segments = 0
        self.unseen = ""  # What the robot's own map says of the floor that it has not seen
        self.last = np.empty((0, 2))  # end of the last segment, where the next one begins
        drive.log_robot(stream, TRACK_M, camera.height_m)

    def send_chunks(self, spread: Spread) -> None:
        """Send the chunks that have been driven and rendered since the last update."""
        # Chunks disappear when the recording is finished; a damaged one will be made again.
        with suppress(FileNotFoundError, DamagedError):
            while (path := chunk_files(self.work, self.chunks)[0]).is_file():
                chunk = read_arrays(path)
                state = chunk["state"]
                yaw = 2 * np.arctan2(state[:, 6], state[:, 3])  # assumes an upright robot
                pose = np.column_stack([state[:, :2], yaw])
                self._send_segments(pose, chunk["segment"], chunk["observation"], spread)
                if "view" in chunk:
                    log_own_map(self.stream, chunk, pose[-1], run_clock(spread(1)))
                self.unseen = tell_unseen(chunk)
                self.chunks += 1
            while (path := chunk_files(self.work, self.pictures)[1]).is_file():
                self._send_pictures(read_arrays(path)["image"][::PICTURE_STRIDE], spread)
                self.pictures += 1

    def send_rest(self, observations: np.ndarray, truth: Truth, spread: Spread) -> None:
        """Send the part of a finished recording that was not sent from its chunks."""
        segment, observation = truth.reading[truth.reading[:, 0] >= self.segments].T
        self._send_segments(truth.pose[self.observations :], segment, observation, spread)
        if not self.pictures:
            self._send_pictures(observations[:: max(1, len(truth.pose) // PICTURE_BATCH)], spread)

    def _send_segments(self, pose: np.ndarray, segment: np.ndarray, observation: np.ndarray, spread: Spread) -> None:
        """Send poses (n, 3) of new observations, and the segments of readings (r,) that start there or just before."""
        if not len(pose):
            return
        place = np.concatenate([self.last, pose[:, :2]])[observation - (self.observations - len(self.last))]
        drive.log_poses(self.stream, pose, run_clock(spread(len(pose))))
        colours = (drive.TRUE_COLOUR, drive.LEG_COLOUR)
        drive.log_path(self.stream, "world/drive", segment, place, colours, spread(len(segment)), run_clock)
        self.observations += len(pose)
        self.segments = int(segment[-1]) + 1
        self.last = pose[-1:, :2]

    def _send_pictures(self, images: np.ndarray, spread: Spread) -> None:
        if images.ndim == 4:  # no scans
            log_polar(self.stream, images, self.camera, run_clock(spread(len(images))))


class LiveView:
    """Sends to the viewer what a run reports: steps done and their number, and each training's history, by label."""

    def __init__(self, stream: rr.RecordingStream, scenario: Scenario, folder: Path) -> None:
        self.steps: dict[str, tuple[int, int]] = {}
        self.histories: dict[str, History] = {}
        self._stream, self._scenario, self._folder = stream, scenario, folder
        self._drive = LiveDrive(stream, folder / "recording", scenario.camera)
        self._truth: Truth | None = None
        self._lengths: dict[str, tuple[int, int]] = {}  # of each history, what is sent of losses and of snapshots
        self._trained: list[str] = []
        self._finished: set[str] = set()
        self._fields: list[str] = []  # methods whose error fields are sent
        self._sent: int | None = None  # when the figures that were sent had been written [ns]
        self._start, self._before = time.monotonic(), 0.0  # start of the view; time of the last update since then [s]
        self._began_s: float | None = None  # start of the training since then [s]
        self._text, self._shown = "", object()
        stream.send_recording_name(f"{scenario.name}, seed {scenario.seed}, live")
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._arrange()

    def update(self) -> None:
        """Send what is new."""
        now = time.monotonic() - self._start
        before, self._before = self._before, now
        if self._began_s is None and self.histories:
            self._began_s = before

        def spread(rows: int) -> np.ndarray:
            return np.linspace(before, now, rows + 1)[1:]

        if self._truth is None:
            self._drive.send_chunks(spread)
            self._send_room(spread)
        if self._truth is not None:
            self._send_trainings(self._truth.pose[:, :2], spread)
        self._send_results()
        self._send_steps()
        self._arrange()

    def _send_room(self, spread: Spread) -> None:
        """Send the room and the rest of a finished recording; without truth, only steps are shown."""
        folder = self._folder / "recording"
        if not (folder / "manifest.json").is_file() or not has_truth(folder):
            return
        recording, self._truth = open_recording(folder), open_truth(folder)
        log_room(self._stream, folder / "scene.glb", self._truth.free_space)
        drive.log_robot(self._stream, drive.find_track_m(recording), drive.camera_of(recording).height_m)
        self._drive.send_rest(recording.observation, self._truth, spread)

    def _send_trainings(self, truth: np.ndarray, spread: Spread) -> None:
        """Send what is new in the histories that trainings report, and in the history files of finished methods."""
        histories = list(dict(self.histories).items())  # the run may add some meanwhile
        for method in self._scenario.methods:
            path = self._folder / method / "history.npz"
            if method not in self._finished and path.is_file():
                with np.load(path, allow_pickle=False) as history:
                    histories.append((method, dict(history)))
                self._finished.add(method)
        for label, history in histories:
            method = label.partition(",")[0]  # a restart has its own label and continues the method's curve
            if method not in self._trained:
                self._trained.append(method)
            losses, snapshots = self._lengths.get(label, (0, 0))
            if new := len(history["loss"]) - losses:
                log_loss(self._stream, method, history, run_clock(spread(new)), losses)
            place, maps = truth[history["snapshot_index"]], history["snapshot"][snapshots:]
            if len(maps):
                log_snapshots(self._stream, method, place, maps, run_clock(spread(len(maps))))
            self._lengths[label] = (losses + new, snapshots + len(maps))

    def _send_results(self) -> None:
        """Send the error fields and the figures once they are written, and again when they change."""
        path = self._folder / METRICS
        written = path.stat().st_mtime_ns if path.is_file() else None
        if self._truth is None or written is None or written == self._sent:
            return
        fields, metrics = read_all_headings(self._folder), read_metrics(self._folder)
        log_results(self._stream, metrics, fields, self._truth.free_space)
        self._fields, self._sent = list(fields), written

    def _send_steps(self) -> None:
        rows = [[title_of(label), f"{done:,}", f"{total:,}"] for label, (done, total) in dict(self.steps).items()]
        text = "\n\n".join(filter(None, (tabulate(["stage", "done", "of"], rows), self._drive.unseen)))
        if text != self._text:
            self._text = text
            put_text(self._stream, layout.STEPS, text)

    def _arrange(self) -> None:
        """Lay out a tab for each stage so far, with the newest in front."""
        shown = (self._truth is not None, list(self._trained), self._fields)
        if shown == self._shown:
            return
        self._shown = shown
        floor, steps = limits(self._truth.free_space) if self._truth else None, layout.text_view("Steps", layout.STEPS)
        pictures = POLAR_PICTURES if self._scenario.observation == "polar_image" else {}
        tabs = [layout.drive(floor, pictures, steps, RUN_TIME, has_room=floor is not None)]
        if floor and self._trained:
            tabs.append(layout.training(dict.fromkeys(self._trained, floor), True, steps, began_s=self._began_s or 0.0))
        if floor and self._fields:
            tabs.append(layout.error_fields(floor, self._fields))
        self._stream.send_blueprint(layout.arrange(tabs, layout.follow(RUN_TIME), len(tabs) - 1))
