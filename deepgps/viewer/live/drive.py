"""The drive while it is collected: segments, robot and pictures, from the chunks that make up a recording."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.data import runs
from deepgps.viewer import playback
from deepgps.viewer.run.drive import ROBOT, ROUND_PX, turn_up
from deepgps.viewer.scene import LAYER_M, lift
from sim.errors import DamagedError
from sim.files.arrays import read_arrays
from sim.recording.format import Recording, Truth, chunk_files, work_folder
from sim.settings import CameraSettings

Spread = Callable[[int], list[rr.TimeColumn]]
"""Makes times for a number of rows, spread over the time since the last update."""

PICTURE_EVERY = 32  # observations
PICTURES_AT_ONCE = 100


class LiveDrive:
    """Sends a drive to the viewer and keeps track of how much has been sent.

    Args:
        stream: Stream to send to.
        folder: The recording's folder, which need not exist yet.
        camera: Settings of the camera that takes the images.
    """

    def __init__(self, stream: rr.RecordingStream, folder: Path, camera: CameraSettings) -> None:
        self.stream, self.work, self.camera = stream, work_folder(folder), camera
        self.chunks = self.pictures = self.observations = 0
        self.segments = 0
        self.last = np.empty((0, 2))  # end of the last segment, where the next one begins

    def send_chunks(self, at: Spread) -> None:
        """Send the chunks that have been driven and rendered since the last update."""
        # Chunks disappear when the recording is finished; a damaged one will be made again.
        with suppress(FileNotFoundError, DamagedError):
            while (path := chunk_files(self.work, self.chunks)[0]).is_file():
                chunk = read_arrays(path)
                state, segment, observation = chunk["state"], chunk["segment"], chunk["observation"]
                yaw = 2 * np.arctan2(state[:, 6], state[:, 3])  # assumes an upright robot
                self._send_segments(np.column_stack([state[:, :2], yaw]), segment, observation, at)
                self.chunks += 1
            while (path := chunk_files(self.work, self.pictures)[1]).is_file():
                self._send_pictures(read_arrays(path)["image"][::PICTURE_EVERY], at)
                self.pictures += 1

    def send_rest(self, recording: Recording, truth: Truth, at: Spread) -> None:
        """Send the part of a finished recording that was not sent from its chunks."""
        segment, observation = truth.reading[truth.reading[:, 0] >= self.segments].T
        self._send_segments(truth.pose[self.observations :], segment, observation, at)
        if not self.pictures:
            self._send_pictures(recording.observation[:: max(1, len(truth.pose) // PICTURES_AT_ONCE)], at)

    def _send_segments(self, pose: np.ndarray, segment: np.ndarray, observation: np.ndarray, at: Spread) -> None:
        """Send poses (n, 3) of new observations, and the segments of readings (r,) that start there or just before."""
        if not len(pose):
            return
        if not self.observations:
            _log_robot(self.stream)
        place = np.concatenate([self.last, pose[:, :2]])
        index = observation - (self.observations - len(self.last))
        start = runs.find_starts(segment)
        end = runs.find_lasts(start)
        ends = [lift(place[index[rows]], LAYER_M) for rows in (start[end], end)]
        self.stream.send_columns(
            "world/drive/path", at(len(end)), rr.LineStrips3D.columns(strips=np.stack(ends, axis=1))
        )
        moved = rr.Transform3D.columns(translation=lift(pose[:, :2], 0.0), quaternion=turn_up(pose[:, 2]))
        self.stream.send_columns(ROBOT, at(len(pose)), moved)
        self.observations += len(pose)
        self.segments = int(segment[-1]) + 1
        self.last = pose[-1:, :2]

    def _send_pictures(self, images: np.ndarray, at: Spread) -> None:
        if images.ndim != 4:  # scans
            return
        _, rings, sectors, _ = images.shape
        warp = playback.make_warp(self.camera, rings, sectors, ROUND_PX)
        rounds = [playback.encode_jpeg(playback.warp_round(image, warp)) for image in images]
        polar = [playback.encode_jpeg(image) for image in images]
        for path, blobs in {"drive/fisheye": rounds, "drive/polar": polar}.items():
            self.stream.send_columns(path, at(len(blobs)), rr.EncodedImage.columns(blob=blobs))


def log_drive_styles(stream: rr.RecordingStream) -> None:
    """Log the static properties of a drive: colour and image format."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("world/drive/path", rr.LineStrips3D.from_fields(radii=0.008, colors=[90, 160, 255]), static=True)
    for path in ("drive/fisheye", "drive/polar"):
        stream.log(path, rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)


def _log_robot(stream: rr.RecordingStream) -> None:
    """Log a mark for the robot's place and heading; its size is known only when the recording is finished."""
    stream.log(f"{ROBOT}/place", rr.Points3D([(0, 0, 0.1)], radii=0.1, colors=[232, 37, 79]), static=True)
    heading = rr.Arrows3D(origins=[(0, 0, 0.1)], vectors=[(0.4, 0, 0)], colors=[255, 196, 60], radii=0.03)
    stream.log(f"{ROBOT}/heading", heading, static=True)
