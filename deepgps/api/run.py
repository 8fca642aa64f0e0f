"""A finished run: what was recorded, how well each method does, and positions of new observations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from rich.console import Console

from deepgps.config.methods import folder_of
from deepgps.config.plugins import load_plugins
from deepgps.config.scenario import Scenario
from deepgps.runs.run_folder import open_run
from deepgps.terminal.progress import ignore
from sim.errors import InputError, quote
from sim.recording.format import Recording, has_truth, open_recording, read_manifest
from sim.recording.manifest import DIMENSIONS, ObservationKind

if TYPE_CHECKING:
    import pyarrow as pa

    from deepgps.evaluation.error_field import ErrorField
    from deepgps.navigation.navigator import Navigator
    from deepgps.positioner.pose import Poses
    from deepgps.positioner.positioner import Positioner
    from deepgps.tracking.causes import Causes
    from deepgps.tracking.track import Track
    from sim.alignment import Alignment

Frame = Literal["world", "map"]


@dataclass(frozen=True)
class Run:
    """A run folder: a recording, methods trained on it, and, if the truth is known, their errors."""

    folder: Path  # The run's folder
    scenario: Scenario  # The scenario that was run

    @cached_property
    def recording(self) -> Recording:
        """What the robot sensed; raises InputError if the recording is missing or damaged."""
        return open_recording(self.folder / "recording")

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Figures of the evaluation, as in ``metrics.json``; raises InputError if the run has not been evaluated."""
        from deepgps.reports.run_report import read_metrics

        return read_metrics(self.folder)

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods that are trained, in the scenario's order."""
        names = self.scenario.methods
        return tuple(name for name in names if (folder_of(self.folder, name) / "positioner.json").is_file())

    def report(self) -> str:
        """What ``deepgps run`` prints: a table of errors, the drive, and what shows that a result cannot be trusted."""
        from deepgps.reports.run_report import print_report

        text = StringIO()
        print_report(self.folder, Console(file=text, width=100))
        return text.getvalue()

    def position(self, observations: np.ndarray, method: str | None = None, frame: Frame = "world") -> np.ndarray:
        """Positions that a trained method predicts.

        Args:
            observations: One observation or an array of N, each of the shape that the recording holds. For a fisheye
                camera these are polar images (rings, sectors, 3) uint8; ``deepgps.unwrap_fisheye`` makes them from
                raw images.
            method: Name of the method; None: the first of the run.
            frame: ``world``: the frame of the recording's truth, which evaluation has aligned the map with; ``map``:
                the method's own frame, which any recording has.

        Returns:
            Positions x, y (N, 2) [m], or (2,) for one observation.

        Raises:
            InputError: There is no such method, the observations have the wrong shape, or the run has no alignment with
                the world.
        """
        from deepgps.learning.trainer import use_threads

        name, batch, single = self._take(observations, method)
        with use_threads(self.scenario.learn.train.threads):  # as in evaluation: to the last bit the same
            found = self.positioner(name)(batch)
        alignment = self.alignment(name, frame)
        found = found if alignment is None else alignment.apply(found)
        return found[0] if single else found

    def pose(self, observations: np.ndarray, method: str | None = None, frame: Frame = "world") -> "Poses":
        """Positions and yaws that a trained method predicts, with standard deviations.

        Args:
            observations: As for ``position``.
            method: Name of the method; None: the first of the run.
            frame: As for ``position``.

        Returns:
            Poses of N observations, or of one without the axis N. What a method does not tell is None.
        """
        from deepgps.learning.trainer import use_threads
        from deepgps.positioner.pose import find_poses

        name, batch, single = self._take(observations, method)
        with use_threads(self.scenario.learn.train.threads):
            found = find_poses(self.positioner(name), batch)
        if alignment := self.alignment(name, frame):
            found = found.align(alignment)
        return found.take(0) if single else found

    def track(self, method: str | None = None, drive: str | Path | None = None) -> "Track":
        """Track the robot through a drive, by single images and odometry together; written as by ``deepgps track``.

        Args:
            method: Name of the method; None: the first of the run.
            drive: Folder of a recording of the same robot in the same room; None: the deployment drive.

        Returns:
            Poses of its images in the method's own frame: ``paths["causal"]`` while driving, ``paths["smoothed"]``
            afterwards, and those by single images and by odometry alone.
        """
        from deepgps.evaluation.track_run import track_run

        return track_run(self.folder, method, None if drive is None else Path(drive), ignore).track

    def navigator(self, method: str | None = None, period_s: float = 0.04) -> "Navigator":
        """A controller that drives the robot to goals on floor that it has driven, by tracked positions of a method.

        Args:
            method: Name of the method; None: the first of the run. It must give a yaw.
            period_s: How long each command is kept [s].

        Returns:
            The navigator; its goals are in the method's own frame, and ``floor.places(...)`` are where they may be.
        """
        from deepgps.learning.trainer import use_threads
        from deepgps.navigation.navigator import Navigator
        from deepgps.navigation.position import Tracked
        from deepgps.navigation.route import lay_floor

        positioner, recording = self.positioner(method), self.recording
        source = Tracked(positioner, recording.manifest.odometry, self.choose(method))
        with use_threads(self.scenario.learn.train.threads):
            places = positioner.locate_training(recording.observation)
        return Navigator(source, lay_floor(recording, places), period_s=period_s)

    def causes(self, method: str | None = None, drive: str | Path | None = None) -> "Causes | None":
        """Name why images of a drive are refused or suspicious.

        Args:
            method: Name of the method; None: the first of the run.
            drive: Folder of a recording of the same robot; None: the deployment drive.

        Returns:
            The cause of each image; None where observations are no images, or the method accepts all.
        """
        from deepgps.evaluation.deployment import open_deployment
        from deepgps.learning.trainer import use_threads
        from deepgps.tracking.causes import name_causes

        recording = open_deployment(self.recording) if drive is None else open_recording(Path(drive))
        if recording is None:
            raise InputError(f"{self.folder} has no deployment drive, which --deployment.drive-samples makes")
        with use_threads(self.scenario.learn.train.threads):
            return name_causes(self.positioner(method), self.recording, recording)

    def alignment(self, method: str | None = None, frame: Frame = "world") -> "Alignment | None":
        """The transform from a method's map to a frame; None: none is needed. Raises InputError as ``position``."""
        from deepgps.evaluation.stored_alignment import has_alignment, read_alignment

        if frame == "map":
            return None
        if frame != "world":
            raise InputError(f"frame {quote(frame)}: must be 'world' or 'map'")
        folder = folder_of(self.folder, self.choose(method))
        if not has_alignment(folder) and not has_truth(self.folder / "recording"):
            raise InputError(
                f"{self.folder} has no truth, so its maps have no place in the world; frame='map' gives positions in "
                "the method's own frame"
            )
        return read_alignment(folder)

    def choose_frame(self, method: str | None = None) -> Frame:
        """The world's frame if evaluation has placed the method's map in it, else the map's own."""
        from deepgps.evaluation.stored_alignment import has_alignment

        return "world" if has_alignment(folder_of(self.folder, self.choose(method))) else "map"

    def errors(self, method: str | None = None) -> "pa.Table":
        """Errors at the test positions, one row for each method, position and heading.

        Args:
            method: Name of the method; None: all methods of the run.

        Returns:
            A table with the columns ``method``, ``x_m``, ``y_m`` and ``heading_rad`` (the truth), ``predicted_x_m``,
            ``predicted_y_m``, ``error_m``, ``predicted_yaw_rad``, ``yaw_error_rad``, ``novelty``, ``radius_68_m``,
            ``radius_95_m`` and ``accepted`` (null where a method does not give them); ``to_pandas()`` turns it into a
            data frame.

        Raises:
            InputError: The run has not been evaluated, or not with this method.
        """
        import pyarrow as pa

        from deepgps.evaluation.error_field import read_all_headings

        if not (self.folder / "error_field.npz").is_file():
            raise InputError(f"{self.folder} has not been evaluated: it has no error_field.npz")
        fields = read_all_headings(self.folder)
        names = list(fields) if method is None else [method]
        if unknown := [name for name in names if name not in fields]:
            raise InputError(f"method {quote(unknown[0])}: {self.folder} has measured {', '.join(fields)}")
        return pa.concat_tables([_tabulate(name, fields[name]) for name in names])

    def choose(self, method: str | None) -> str:
        """The name of a trained method; None: the first of the run. Raises InputError if it is not trained."""
        if not self.methods:
            raise InputError(f"{self.folder} holds no trained method")
        if method is None:
            return self.methods[0]
        if method not in self.methods:
            raise InputError(f"method {quote(method)}: {self.folder} has trained {', '.join(self.methods)}")
        return method

    @cached_property
    def _kind(self) -> ObservationKind:
        kind = read_manifest(self.folder / "recording").kind
        if kind is None:
            raise InputError(f"{self.folder / 'recording'} names no sensor")
        return kind

    @cached_property
    def _positioners(self) -> "dict[str, Positioner]":
        return {}

    def positioner(self, method: str | None = None) -> "Positioner":
        """The map from observations to positions that a method has learned; None: the first of the run."""
        from deepgps.positioner.stored_positioner import load_positioner

        name = self.choose(method)
        if name not in self._positioners:
            self._positioners[name] = load_positioner(folder_of(self.folder, name))
        return self._positioners[name]

    def _take(self, observations: np.ndarray, method: str | None) -> tuple[str, np.ndarray, bool]:
        """The method's name, an array of observations, and whether only one was given."""
        name, array = self.choose(method), np.asarray(observations)
        if self._kind != "polar_image":
            array = array.astype(np.float32)
        elif array.dtype != np.uint8:
            raise InputError(f"observations {array.shape} {array.dtype}: polar images must be uint8, as recorded")
        single = array.ndim == DIMENSIONS[self._kind] - 1
        return name, array[None] if single else array, single


def load(folder: str | Path, plugins: Sequence[str | Path] = ()) -> Run:
    """Open a run folder, with the files of the plugins that its methods need."""
    load_plugins(plugins)
    return Run(Path(folder), open_run(Path(folder)))


def _tabulate(name: str, field: "ErrorField") -> "pa.Table":
    import pyarrow as pa

    place = np.repeat(field.truth, field.predicted.shape[1], axis=0)
    guess = field.predicted.reshape(-1, 2)
    heading = np.broadcast_to(field.heading, field.predicted.shape[:2])

    def as_column(part: np.ndarray | None) -> pa.Array:
        values = np.full(len(place), np.nan) if part is None else part.ravel().astype(float)
        return pa.array(values, mask=np.isnan(values))

    columns = {
        "method": pa.array([name] * len(place)),
        "x_m": place[:, 0],
        "y_m": place[:, 1],
        "heading_rad": np.ascontiguousarray(heading).ravel(),
        "predicted_x_m": guess[:, 0],
        "predicted_y_m": guess[:, 1],
        "error_m": np.linalg.norm(guess - place, axis=1),
        "predicted_yaw_rad": as_column(field.yaw),
        "yaw_error_rad": as_column(field.yaw_error),
        "novelty": as_column(field.novelty),
        "radius_68_m": as_column(field.radius),
        "radius_95_m": as_column(field.radius_95),
        "accepted": pa.array(field.is_accepted.ravel(), mask=np.full(len(place), field.accepted is None)),
    }
    return pa.table(columns)
