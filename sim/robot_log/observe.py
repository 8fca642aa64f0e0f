"""What the robot's two computers observe of a repeated drive, each stamped by its own clock; unsynchronised.

The computer with the camera records the log. The one with the wheels and the rays stamps its messages by a clock that
differs from the recorder's by a few seconds and runs a little faster or slower. Worker processes draw and compress the
raw pictures, a file for each few hundred.
"""

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import cv2
import mujoco
import numpy as np

from sim.files.checksums import read_arrays, write_arrays
from sim.geometry import planar_pose
from sim.recording.chunks import drive_chunk
from sim.recording.renderers import Part, UnsteadyError
from sim.rng import stream
from sim.robot.model import WHEELS
from sim.robot.range_finder import ANGLE
from sim.robot.world import RoomWorld
from sim.rooms.spec import ROBOT_PREFIX
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

    def fire(self, period_s: float, first_s: float, last_s: float) -> np.ndarray:
        """Times of the simulation [s], after ``first_s`` and up to ``last_s``, when a timer of this period fires."""
        step_s = period_s / (1.0 + self.drift)
        return np.arange(np.floor(first_s / step_s) + 1, np.floor(last_s / step_s) + 1) * step_s


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
        self.wheels = [self.model.joint(ROBOT_PREFIX + name).qposadr[0] for name in WHEELS]
        self._kept: list[tuple[float, np.ndarray]] = []

    def advance(self, steps: int) -> None:
        """Let physics pass by so many of its time steps."""
        for _ in range(steps):
            super().advance(1)
            self._kept.append((self.data.time, self.data.qpos.copy()))

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) [s] and full positions (n, nq) of all steps since the last call."""
        times, states = zip(*self._kept, strict=True)
        self._kept = []
        return np.array(times), np.array(states)


@dataclass(frozen=True)
class Stretch:
    """A stretch of the drive, as long as a recording's chunk."""

    begun: float  # Time at its beginning [s]
    time: np.ndarray  # Time after each step of the physics (n,) [s]
    state: np.ndarray  # Full positions then (n, nq)
    observations: int  # Number of the recording's observations up to its end
    wheel_angle: np.ndarray  # Wheel angles at the recording's readings in it (r, 2) [rad]

    def find(self, clock: Clock, period_s: float) -> np.ndarray:
        """Rows (m,) of the states when a timer of this period fires by a computer's clock."""
        return np.searchsorted(self.time + 1e-6, clock.fire(period_s, self.begun, float(self.time[-1])))


def trace_drive(world: TracedWorld, seed: int) -> Iterator[Stretch]:
    """Repeat the drive of the recording with the world's settings and this seed."""
    settings, rng = world.settings, stream(seed, "drive")
    chunk, begun, driven = None, 0.0, 0
    while driven < settings.drive.samples + settings.grid.held_out:
        chunk = drive_chunk(world, settings, rng, chunk)
        time, state = world.take()
        driven = int(chunk["observations"])
        yield Stretch(begun, time, state, driven, chunk["wheel_angle"])
        begun = float(time[-1])


JOINT_S, PICTURE_S, RAY_S, TRUTH_S = 0.05, 0.1, 0.2, 0.05
"""Periods of the wheels (TurtleBot3: 20 Hz), the pictures, the rays and the truth [s]."""


@dataclass(frozen=True)
class Observed:
    """Readings with their times in the simulation [s]."""

    joint_time: np.ndarray  # Times of the wheel angles (J,)
    joint_angle: np.ndarray  # Left and right wheel angle (J, 2) [rad]
    picture_time: np.ndarray  # Times of the pictures (P,)
    picture_state: np.ndarray  # Full positions at them (P, nq)
    ray_time: np.ndarray  # Times of the rays (Q,)
    ray_m: np.ndarray  # Distance to what is nearest in each direction, at any height of the robot (Q, K) [m]
    truth_time: np.ndarray  # Times of the true poses (T,)
    truth_pose: np.ndarray  # True poses (T, 3) x, y [m], yaw [rad]


def observe(world: TracedWorld, stretch: Stretch, base: Clock) -> Observed:
    """Read everything in a stretch of the drive; ``base`` is the clock of the wheels and the rays."""
    joint, ray = (stretch.find(base, period_s) for period_s in (JOINT_S, RAY_S))
    picture, truth = (stretch.find(RECORDER, period_s) for period_s in (PICTURE_S, TRUTH_S))
    fans = [world.ranges_at(pose).reshape(-1, len(ANGLE)) for pose in planar_pose(stretch.state[ray])]
    return Observed(
        joint_time=stretch.time[joint],
        joint_angle=stretch.state[joint][:, world.wheels],
        picture_time=stretch.time[picture],
        picture_state=stretch.state[picture],
        ray_time=stretch.time[ray],
        ray_m=np.array([fan.min(axis=0) for fan in fans]).reshape(-1, len(ANGLE)),
        truth_time=stretch.time[truth],
        truth_pose=planar_pose(stretch.state[truth]),
    )


def join(parts: Sequence[Observed]) -> Observed:
    """All readings of consecutive stretches."""
    names = [field.name for field in fields(Observed)]
    return Observed(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


ROWS, COLUMNS = 480, 640
"""Size of the image (TurtleBot3: 640 x 480); the round picture is as high and in its middle [px]."""
FACE_PX = 160  # Side of the faces that it is drawn from: half of what would resolve each of its pixels, for speed
QUALITY = 85
PART_PICTURES = 256
JPEG, END = "jpeg", "end"
Sense = Callable[[np.ndarray, np.ndarray | None], np.ndarray]
"""(state (nq,), lean of the camera (2,) [rad] or None) -> image (ROWS, COLUMNS, 3) RGB."""


def draw_part(part: Part, beat: Callable[[], None]) -> None:
    """Run in a worker: draw the pictures of a part's states and write their JPEG files, one after the other.

    Raises UnsteadyError if a picture that was drawn twice came out different; nothing is written.
    """
    sense = open_camera(part.settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    files = []
    for number in range(len(part.states)):
        files.append(_take(sense, part, number))
        beat()
    again = zlib.crc32(part.path.name.encode()) % max(len(files) - 1, 1)
    if not np.array_equal(_take(sense, part, again), files[again]):
        raise UnsteadyError(f"{part.path}: picture {again} of {len(files)} was drawn twice and came out different")
    write_arrays(part.path, {JPEG: np.concatenate(files), END: np.cumsum([len(file) for file in files])})


@lru_cache(maxsize=1)
def open_camera(settings: SimSettings) -> Sense:
    """The camera, opened once per worker process, since a context belongs to its process."""
    model = RoomWorld(settings.model_copy(update={"deployment": DeploymentSettings()})).model
    camera = Fisheye(model, settings.camera.model_copy(update={"face_px": FACE_PX}), settings.camera_mount)
    data, side = mujoco.MjData(model), (COLUMNS - ROWS) // 2

    def sense(state: np.ndarray, lean: np.ndarray | None) -> np.ndarray:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        return np.pad(camera.round(data, ROWS, lean), ((0, 0), (side, side), (0, 0)))

    return sense


def read_pictures(path: Path) -> list[np.ndarray]:
    """The JPEG files of a part, each (n,) uint8; raises DamagedError."""
    stored = read_arrays(path)
    return np.split(stored[JPEG], stored[END][:-1])


def _take(sense: Sense, part: Part, number: int) -> np.ndarray:
    image = sense(part.states[number], None if part.leans is None else part.leans[number])
    done, file = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return file
