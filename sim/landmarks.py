"""The paper's plane world (Sec. IV-A): a square with landmarks, seen as distances, and a robot that is a point.

No MuJoCo: the robot drives straight until it meets a wall, turns by chance and drives on. It observes every
``drive.spacing_m`` the distance to each landmark, a vector in place of an image. What is written is a recording as any
other; encoders are read from the way as those of a room are, with the faults that the settings ask for.
"""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from sim.encoder import read_encoders
from sim.records import FreeSpace, save_free_space, write_recording
from sim.settings import SimSettings
from sim.streams import stream

WHEEL_RADIUS_M, TRACK_M = 0.033, 0.16
"""Wheels that the robot would have, by which a way becomes ticks; those of a TurtleBot3 Burger."""
CELL_M = 0.02
LEAST_STEPS = 3
"""A heading that leads to a wall in fewer steps than this is drawn again."""
PACKAGES = ("numpy",)
Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Drive:
    """What was driven.

    Attributes:
        pose: Pose at each observation (N, 3): x, y [m], yaw [rad].
        reading: Segment and observation of each reading (R, 2); a turning place has two readings.
        wheel_angle: Angle of left and right wheel at each reading (R, 2) [rad].
        time: Time of each reading (R,) [s].
    """

    pose: np.ndarray
    reading: np.ndarray
    wheel_angle: np.ndarray
    time: np.ndarray


class LandmarkWorld:
    """A square about the origin with landmarks in it.

    Attributes:
        landmark: Where they stand (M, 2) [m].
        bounds: Lower and upper corner (2, 2) [m].
    """

    def __init__(self, settings: SimSettings, seed: int) -> None:
        """Place the landmarks uniformly over the square, from the settings' own seed or else from this one."""
        self.settings = settings.landmarks
        half = self.settings.side_m / 2
        self.bounds = np.array([[-half, -half], [half, half]])
        rng = stream(seed if self.settings.seed is None else self.settings.seed, "landmarks")
        self.landmark = rng.uniform(-half, half, (self.settings.count, 2))

    def is_free(self, points: np.ndarray) -> np.ndarray:
        """Whether ``points`` (..., 2) [m] lie in the square."""
        return np.all(np.abs(points) <= self.settings.side_m / 2, axis=-1)

    def observe(self, poses: np.ndarray) -> np.ndarray:
        """Distances (..., M) float32 [m] from poses (..., 3) to the landmarks; the reach for what lies beyond it."""
        distance = np.linalg.norm(poses[..., None, :2] - self.landmark, axis=-1)
        return np.minimum(distance, self.settings.reach_m or np.inf).astype(np.float32)

    def way_ahead(self, place: np.ndarray, yaw: float) -> float:
        """Way from a place (2,) [m] in the square along a heading [rad] to the wall [m]."""
        direction = np.array([np.cos(yaw), np.sin(yaw)])
        low, high = self.bounds
        room = np.where(direction > 0, high - place, place - low)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # along a wall the way to it is infinite
            return float(np.nanmin(room / np.abs(direction)))


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report) -> None:
    """Make a recording of the landmarks world, or leave the finished one that stands.

    Args:
        settings: Landmarks, encoder, drive (speeds, spacing, samples at most) and test grid are used.
        seed: Landmarks, driving and encoder draw from streams of this number.
        folder: The recording's folder; finished once it holds ``manifest.json``.
        progress: Told how many segments are driven.
    """
    if (folder / "manifest.json").is_file():
        return
    start = time.perf_counter()
    world = LandmarkWorld(settings, seed)
    drive = drive_segments(world, settings, stream(seed, "drive"), progress)
    test_pose = lay_grid(world, settings)
    ticks, arrived = read_encoders(drive.wheel_angle, WHEEL_RADIUS_M, settings.encoder, stream(seed, "encoder"))
    shutil.rmtree(folder, ignore_errors=True)  # what a killed collection left
    save_free_space(folder / "truth" / "free_space.npz", lay_free_space(world))
    arrays = {
        "observation.npy": world.observe(drive.pose),
        "reading.npy": np.column_stack([drive.reading, ticks])[arrived],
        "time.npy": drive.time[arrived],
        "test/observation.npy": world.observe(test_pose),
        "truth/pose.npy": drive.pose,
        "truth/reading.npy": drive.reading,
        "truth/wheel_angle.npy": drive.wheel_angle,
        "truth/test_pose.npy": test_pose,
        "truth/landmark.npy": world.landmark,
    }
    manifest = {
        "settings": settings.model_dump(mode="json"),
        "seed": seed,
        **count_drive(drive),
        "readings_lost": int((~arrived).sum()),
        "odometry": {
            "wheel_radius_m": WHEEL_RADIUS_M,
            "track_m": TRACK_M * (1.0 + settings.encoder.track_error),
            "ticks_per_rev": settings.encoder.ticks_per_rev,
        },
        "gl_renderer": "none",
        "packages": {name: version(name) for name in PACKAGES},
        "collect_s": round(time.perf_counter() - start, 2),
    }
    write_recording(folder, arrays, manifest)


def drive_segments(world: LandmarkWorld, settings: SimSettings, rng: np.random.Generator, progress: Report) -> Drive:
    """Drive straight segments from wall to wall, from a random place, headings by chance (paper, Sec. IV-A)."""
    drive, wanted = settings.drive, settings.landmarks.segments
    place, yaw, angle, clock = rng.uniform(*world.bounds), 0.0, np.zeros(2), 0.0
    pose, reading, angles, times = [np.array([*place, yaw])], [], [], []
    for segment in range(wanted):
        heading, steps = choose_heading(world, place, drive.spacing_m, drive.longest_m, rng)
        turn = (heading - yaw + np.pi) % (2 * np.pi) - np.pi
        along = drive.spacing_m * np.arange(steps + 1)
        points = place + along[:, None] * [np.cos(heading), np.sin(heading)]
        angle = angle + np.array([-turn, turn]) * TRACK_M / 2 / WHEEL_RADIUS_M
        clock += abs(turn) / drive.turn_rate_rps
        observation = len(pose) - 1 + np.arange(steps + 1)
        pose.extend(np.column_stack([points[1:], np.full(steps, heading)]))
        reading.append(np.column_stack([np.full(steps + 1, segment), observation]))
        angles.append(angle + along[:, None] / WHEEL_RADIUS_M)
        times.append(clock + along / drive.speed_mps)
        place, yaw, angle, clock = points[-1], heading, angles[-1][-1], times[-1][-1]
        progress("drive", segment + 1, wanted)
        if len(pose) >= drive.samples:
            break
    numbers = np.concatenate(reading)
    kept = numbers[:, 1] < drive.samples
    return Drive(
        np.array(pose[: drive.samples]), numbers[kept], np.concatenate(angles)[kept], np.concatenate(times)[kept]
    )


def choose_heading(
    world: LandmarkWorld, place: np.ndarray, spacing_m: float, longest_m: float, rng: np.random.Generator
) -> tuple[float, int]:
    """A heading [rad], uniform among those that do not end at once, and how many spacings it leads ahead."""
    while True:
        heading = rng.uniform(-np.pi, np.pi)
        # A place at the wall may lie beyond it by a rounding error.
        steps = int(min(world.way_ahead(place, heading), longest_m) / spacing_m + 1e-9)
        if steps >= LEAST_STEPS:
            return heading, steps


def lay_grid(world: LandmarkWorld, settings: SimSettings) -> np.ndarray:
    """Poses (C, H, 3) of the test grid over the square, walls included, headings spread evenly from +x."""
    low, high = world.bounds[:, 0]
    side = np.linspace(low, high, round((high - low) / settings.grid.spacing_m) + 1)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 1, 2)
    headings = settings.grid.headings
    yaw = np.broadcast_to(2 * np.pi * np.arange(headings)[:, None] / headings, (len(points), headings, 1))
    return np.concatenate([points.repeat(headings, axis=1), yaw], axis=-1)


def lay_free_space(world: LandmarkWorld) -> FreeSpace:
    """The square as cells, all of it reachable, with a rim of cells that are not."""
    low, high = world.bounds[:, 0]
    side = np.arange(round((high - low) / CELL_M) + 3)
    origin = np.full(2, low - CELL_M)
    inside = (side > 0) & (side < len(side) - 1)
    free = inside[:, None] & inside[None]
    return FreeSpace(origin, CELL_M, free, free.copy(), np.zeros(2), float(high - low))


def count_drive(drive: Drive) -> dict[str, float]:
    """What the manifest says of a drive."""
    number, way_m = drive.reading[:, 0], drive.wheel_angle.mean(axis=1) * WHEEL_RADIUS_M
    return {
        "samples": len(drive.pose),
        "segments": int(number[-1]) + 1,
        "readings": len(drive.reading),
        "distance_driven_m": round(float(np.diff(way_m)[np.diff(number) == 0].sum()), 3),
    }
