"""Trainings in progress: loss and map of each, as far as the history goes."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.config.methods import title_of
from deepgps.reports.style import colour_on_dark
from deepgps.viewer import playback
from deepgps.viewer.live.drive import Spread
from deepgps.viewer.run.training import lay_upon, take_log
from deepgps.viewer.scene import LAYER_M, lift

Arrays = Mapping[str, np.ndarray]


class LiveTraining:
    """Sends trainings to the viewer and keeps track of how much of each has been sent.

    Args:
        stream: Stream to send to.
        folder: The run folder.
        truth: True position of each observation (N, 2) [m], to which maps are aligned.
    """

    def __init__(self, stream: rr.RecordingStream, folder: Path, truth: np.ndarray) -> None:
        self.stream, self.folder, self.truth = stream, folder, truth
        self.sent: dict[str, tuple[int, int]] = {}  # numbers of losses and of snapshots
        self.trained: list[str] = []
        self.finished: set[str] = set()

    def send(self, histories: Mapping[str, Arrays], methods: tuple[str, ...], at: Spread) -> None:
        """Send what is new in the histories that trainings report, and in the history files of finished methods."""
        for label, history in histories.items():
            self._send_history(label, history, at)
        for method in methods:
            path = self.folder / method / "history.npz"
            if method not in self.finished and path.is_file():
                with np.load(path, allow_pickle=False) as history:
                    self._send_history(method, history, at)
                self.finished.add(method)

    def _send_history(self, label: str, history: Arrays, at: Spread) -> None:
        method = label.partition(",")[0]  # a restart has its own label and continues the method's curve
        if method not in self.trained:
            self.trained.append(method)
            self._log_styles(method)
        points, snapshots = self.sent.get(label, (0, 0))
        loss = take_log(history["loss"][points:])
        if len(loss):
            self.stream.send_columns(f"training/{method}/loss", at(len(loss)), rr.Scalars.columns(scalars=loss))
        place = self.truth[history["snapshot_index"]]
        maps = history["snapshot"][snapshots:]
        if len(maps):
            laid = np.concatenate(lay_upon(method, maps, place))
            colours = np.tile(playback.colours_of_places(place), (len(maps), 1))
            rows = rr.Points3D.columns(positions=lift(laid, LAYER_M), colors=colours)
            self.stream.send_columns(
                f"world/training/{method}", at(len(maps)), rows.partition([len(place)] * len(maps))
            )
        self.sent[label] = (points + len(loss), snapshots + len(maps))

    def _log_styles(self, method: str) -> None:
        style = rr.SeriesLines(colors=[colour_on_dark(method)], names=title_of(method), widths=1.5)
        self.stream.log(f"training/{method}/loss", style, static=True)
        self.stream.log(f"world/training/{method}", rr.Points3D.from_fields(radii=0.025), static=True)
