"""What the robot's two computers observe of a repeated drive, each stamped by its own clock; unsynchronised.

The computer with the camera records the log. The one with the wheels has a clock that differs from the recorder's by a
few seconds and runs a little faster or slower.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from sim.recording.chunks import count_wanted, drive_chunk, find_least
from sim.recording.format import Report
from sim.rng import stream
from sim.robot.world import RoomWorld
from sim.sensors.camera.fisheye import Fisheye
from sim.settings import DeploymentSettings, SimSettings

EPOCH_NS = 1_767_225_600 * 10**9  # What the recorder's clock reads when the drive begins: 1 January 2026, 0:00 UTC [ns]
OFFSET_S = (1.0, 5.0)  # Least and largest difference between the clocks when the drive begins [s]
DRIFT = (20e-6, 50e-6)
"""Least and largest relative difference of their rates (quartz oscillators have some 20 to 50 millionths)."""


@dataclass(frozen=True)
class Clock:
    """A computer's clock."""

    offset_s: float = 0.0  # How far it is ahead of the recorder's when the drive begins [s]
    drift: float = 0.0  # How much faster it runs than the simulation's time, as a fraction

    def read(self, time_s: np.ndarray) -> np.ndarray:
        """What it reads (...) int64 [ns since 1970] at times of the simulation (...) [s]."""
        return EPOCH_NS + np.rint((self.offset_s + np.asarray(time_s) * (1.0 + self.drift)) * 1e9).astype(np.int64)

    def fire(self, period_s: float, end_s: float) -> np.ndarray:
        """Times of the simulation [s], after 0 and up to the end, when a timer of this period fires."""
        step_s = period_s / (1.0 + self.drift)
        return np.arange(1, np.floor(end_s / step_s) + 1) * step_s


RECORDER = Clock()


def make_base_clock(seed: int) -> Clock:
    """The clock of the computer with the wheels, by the scenario's seed."""
    rng = stream(seed, "log", "clock")
    offset_s, drift = (rng.choice((-1.0, 1.0)) * rng.uniform(*limits) for limits in (OFFSET_S, DRIFT))
    return Clock(float(offset_s), float(drift))


class TracedWorld(RoomWorld):
    """A room that keeps the state after each time step of its physics, which goes on bit for bit as without."""

    def __init__(self, settings: SimSettings, room: mujoco.MjSpec | None = None) -> None:
        super().__init__(settings.model_copy(update={"deployment": DeploymentSettings()}), room, drawn=False)
        self.kept: list[np.ndarray] = []  # Full position and time (nq + 1,) after each step

    def advance(self, steps: int) -> None:
        """Let physics pass by so many of its time steps."""
        for _ in range(steps):
            super().advance(1)
            self.kept.append(np.append(self.data.qpos, self.data.time))


class Trace(NamedTuple):
    """A drive at each step of the physics."""

    time: np.ndarray  # Time after the step (n,) [s]
    state: np.ndarray  # Full positions then (n, nq)

    def find(self, clock: Clock, period_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Times (m,) [s] and full positions (m, nq) when a timer of this period fires by a computer's clock."""
        rows = np.searchsorted(self.time + 1e-6, clock.fire(period_s, float(self.time[-1])))
        return self.time[rows], self.state[rows]


def trace_drive(world: TracedWorld, seed: int, samples: int, progress: Report) -> tuple[Trace, np.ndarray]:
    """Repeat the drive of the recording with the world's settings, this seed and so many samples.

    Returns also the wheel angles (r, 2) [rad] at the recording's readings.
    """
    settings, rng = world.settings, stream(seed, "drive")
    driven, wanted, least = 0, 1, 0
    chunk, steps, angle = None, list[np.ndarray](), list[np.ndarray]()
    while driven < wanted:
        chunk = drive_chunk(world, settings, rng, chunk, least)
        steps.append(np.array(world.kept))
        world.kept.clear()
        angle.append(chunk["wheel_angle"])
        driven, wanted = count_wanted(settings, chunk, least)
        if driven == wanted < samples:
            least = find_least(driven)
            wanted = count_wanted(settings, chunk, least)[1]
        progress("log drive", driven, wanted)
    step = np.concatenate(steps)
    return Trace(step[:, -1], step[:, :-1]), np.concatenate(angle)


ROWS, COLUMNS = 480, 640
"""Size of the image (TurtleBot3: 640 x 480); the round picture is as high and in its middle [px]."""
FACE_PX = 160  # Side of the faces that it is drawn from: half of what would resolve each of its pixels, for speed
QUALITY = 85


def open_camera(settings: SimSettings) -> Callable[[np.ndarray, np.ndarray | None], np.ndarray]:
    """The camera in the room as it is in training: of a state (nq,), with a lean (2,) [rad] or None, it gives the JPEG
    file (n,) uint8 of an image (ROWS, COLUMNS, 3)."""
    model = RoomWorld(settings.model_copy(update={"deployment": DeploymentSettings()})).model
    camera = Fisheye(model, settings.camera.model_copy(update={"face_px": FACE_PX}), settings.camera_mount)
    data, side = mujoco.MjData(model), (COLUMNS - ROWS) // 2

    def sense(state: np.ndarray, lean: np.ndarray | None) -> np.ndarray:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        image = np.pad(camera.round(data, ROWS, lean), ((0, 0), (side, side), (0, 0)))
        return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]

    return sense
