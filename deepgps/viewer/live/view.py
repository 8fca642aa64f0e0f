"""What a viewer shows of a run in progress: the drive, the training and the error field, each as far as it goes.

All rows are on one timeline, ``run_time`` [s], which starts with the view. New rows are spread over the time since the
last update, so that they play back smoothly.
"""

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.config.methods import title_of
from deepgps.config.scenario import Scenario
from deepgps.data.plausible_readings import keep_plausible
from deepgps.evaluation.error_field import read_all_headings
from deepgps.reports.run_report import OVERVIEW, markdown_table, read_metrics
from deepgps.reports.table import tabulate
from deepgps.runs.run_folder import METRICS
from deepgps.viewer.error_field import log_field
from deepgps.viewer.live.drive import LiveDrive, Spread, log_drive_styles
from deepgps.viewer.live.layout import RUN_TIME, make_live_blueprint
from deepgps.viewer.live.training import LiveTraining
from deepgps.viewer.scene import log_room, log_scale
from sim.occupancy import FreeSpace
from sim.recording.format import has_truth, open_recording, open_truth


class LiveView:
    """Collects what a run reports and sends it to the viewer.

    Args:
        stream: Stream to send to.
        scenario: The run's scenario.
        folder: The run folder.

    Attributes:
        steps: Steps done and their number, by reported label.
        histories: Each training's history so far, by reported label.
    """

    def __init__(self, stream: rr.RecordingStream, scenario: Scenario, folder: Path) -> None:
        self.steps: dict[str, tuple[int, int]] = {}
        self.histories: dict[str, Mapping[str, np.ndarray]] = {}
        self._stream, self._scenario, self._folder = stream, scenario, folder
        self._drive = LiveDrive(stream, folder / "recording", scenario.camera)
        self._space: FreeSpace | None = None
        self._training: LiveTraining | None = None
        self._measured: list[str] = []
        self._sent: int | None = None  # when the figures that were sent had been written [ns]
        self._start, self._before = time.monotonic(), 0.0  # start of the view; time of the last update since then [s]
        self._began_s: float | None = None  # start of the training since then [s]
        self._text, self._shown = "", object()
        stream.send_recording_name(f"{scenario.name}, seed {scenario.seed}, live")
        log_drive_styles(stream)
        self._arrange()

    def update(self) -> None:
        """Send what is new."""
        now = time.monotonic() - self._start
        before, self._before = self._before, now
        if self._began_s is None and self.histories:
            self._began_s = before

        def at(rows: int) -> list[rr.TimeColumn]:
            return [rr.TimeColumn(RUN_TIME, duration=np.linspace(before, now, rows + 1)[1:])]

        if self._training is None:
            self._drive.send_chunks(at)
        if self._training is None and self._has_truth():
            self._training = self._send_room(at)
        if self._training is not None:
            self._training.send(dict(self.histories), self._scenario.methods, at)
        written = _find_time(self._folder / METRICS)
        if self._space is not None and written is not None and written != self._sent:
            self._measured, self._sent = self._send_results(self._space), written
        self._send_steps()
        self._arrange()

    def _has_truth(self) -> bool:
        """Whether the recording is finished and its places are known; without them, only steps are shown."""
        folder = self._folder / "recording"
        return (folder / "manifest.json").is_file() and has_truth(folder)

    def _send_room(self, at: Spread) -> LiveTraining:
        """Send the room and the rest of the finished recording; return the view of the training that follows."""
        recording = keep_plausible(open_recording(self._folder / "recording"))
        truth = open_truth(self._folder / "recording")
        self._space = truth.free_space
        log_room(self._stream, recording.folder / "scene.glb", self._space)
        self._drive.send_rest(recording, truth, at)
        return LiveTraining(self._stream, self._folder, truth.pose[:, :2])

    def _send_results(self, space: FreeSpace) -> list[str]:
        """Send the error fields and the figures; return the measured methods."""
        fields, metrics = read_all_headings(self._folder), read_metrics(self._folder)
        for name, field in fields.items():
            log_field(self._stream, name, field)
        log_scale(self._stream, space)
        text = f"# {self._scenario.name}, seed {self._scenario.seed}\n\n{markdown_table(metrics, OVERVIEW)}"
        self._stream.log("report/figures", rr.TextDocument(text, media_type="text/markdown"), static=True)
        return list(fields)

    def _send_steps(self) -> None:
        rows = [[title_of(label), f"{done:,}", f"{total:,}"] for label, (done, total) in dict(self.steps).items()]
        text = tabulate(["stage", "done", "of"], rows)
        if text == self._text:
            return
        self._text = text
        self._stream.log("steps", rr.TextDocument(text, media_type="text/markdown"), static=True)

    def _arrange(self) -> None:
        """Send a new layout if there is something new to show."""
        trained = list(self._training.trained) if self._training else []
        pictures = self._scenario.observation == "polar_image"
        shown = (self._space is not None, trained, self._measured)
        if shown != self._shown:
            self._shown = shown
            layout = make_live_blueprint(self._space, pictures, trained, self._began_s or 0.0, self._measured)
            self._stream.send_blueprint(layout)


def _find_time(path: Path) -> int | None:
    """When a file was written [ns]; None: there is none."""
    return path.stat().st_mtime_ns if path.is_file() else None
