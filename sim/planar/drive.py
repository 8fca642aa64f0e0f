"""What all plane worlds share: a point robot drives straight, turns in a random direction and drives on. No MuJoCo.

The robot takes an observation every ``drive.spacing_m``. The result is a recording like any other; encoder readings are
computed from the distance travelled as in a room, with the errors that the settings ask for.
"""

import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from sim.errors import WorkError
from sim.geometry import save_free_space, wrap
from sim.planar.worlds import LandmarkWorld, LidarWorld
from sim.recording.format import (
    Report,
    grid_file,
    measure_driven,
    observation_file,
    remove_recording,
    stamp,
    time_file,
    turn_file,
    write_files,
)
from sim.recording.manifest import name_sensors
from sim.recording.turns import FILE as TURNS
from sim.recording.turns import KINDS, Turns, count_images, list_turns, lose_turns
from sim.rng import stream
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import TURN_RATE_RPS, SimSettings

WHEEL_RADIUS_M, TRACK_M = 0.033, 0.16
"""Nominal wheels that convert a distance travelled to ticks: those of a TurtleBot3 Burger."""
MIN_STEPS = 3  # A heading that meets a wall in fewer steps than this is drawn again
TRIES = 10_000  # Draws of a heading before the robot is taken to be stuck
World = LandmarkWorld | LidarWorld


@dataclass(frozen=True)
class PlanarDrive:
    """A finished drive."""

    pose: np.ndarray  # Pose at each observation (N, 3): x, y [m], yaw [rad]
    reading: np.ndarray  # Segment and observation of each reading (R, 2); a turning place has two readings
    wheel_angle: np.ndarray  # Angle of left and right wheel at each reading (R, 2) [rad]
    time: np.ndarray  # Time of each reading (R,) [s]
    turns: Turns  # The turns between segments
    turn_pose: np.ndarray  # Pose after each turn in place (K, 3)


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report) -> None:
    """Make a recording of a plane world, unless there is a complete one, which holds ``manifest.json``.

    World, lidar, encoder, drive (speeds, spacing, samples at most) and test grid of the settings are used. Progress is
    a stage (``drive``), the samples done and the largest number that there can be. Raises InputError if there is no
    room for any test position, WorkError if the robot finds no way on.
    """
    if (folder / "manifest.json").is_file():
        return
    start = time.perf_counter()
    world = (LandmarkWorld if settings.world == "landmarks" else LidarWorld)(settings, seed)
    test_pose = world.lay_grid(settings.grid)
    drive = drive_segments(world, settings, stream(seed, "drive"), progress)
    ticks, arrived = read_encoders(drive.wheel_angle, WHEEL_RADIUS_M, settings.encoder, stream(seed, "encoder"))
    remove_recording(folder)  # what an interrupted collection left behind
    save_free_space(folder / "truth" / "free_space.npz", world.space)
    sensors = name_sensors(settings)
    sensor, *_ = sensors
    arrays = {
        observation_file(sensor): world.measure(drive.pose),
        time_file(sensor): stamp(drive.reading[:, 1], drive.time, len(drive.pose)),
        "reading.npy": np.column_stack([drive.reading, ticks])[arrived],
        "time.npy": drive.time[arrived],
        grid_file(sensor): world.measure(test_pose),
        "truth/pose.npy": drive.pose,
        "truth/reading.npy": drive.reading,
        "truth/wheel_angle.npy": drive.wheel_angle,
        "truth/test_pose.npy": test_pose,
        **{f"truth/{name}": array for name, array in world.truth.items()},
    }
    if world.turn_images and settings.drive.turn_images:
        arrays[TURNS] = lose_turns(drive.turns, drive.reading[:, 0], arrived).array
        arrays[turn_file(sensor)] = world.measure(drive.turn_pose, turned=True)
    manifest = {
        "sensors": sensors,
        "settings": settings.model_dump(mode="json"),
        "seed": seed,
        "samples": len(drive.pose),
        "segments": int(drive.reading[-1, 0]) + 1,
        "readings": len(drive.reading),
        "distance_driven_m": measure_driven(drive.reading[:, 0], drive.wheel_angle.mean(axis=1) * WHEEL_RADIUS_M),
        "readings_lost": int((~arrived).sum()),
        "odometry": describe_odometry(settings.encoder, WHEEL_RADIUS_M, TRACK_M),
        "gl_renderer": "none",
        "packages": {"numpy": version("numpy")},
        "collect_s": round(time.perf_counter() - start, 2),
    }
    write_files(folder, arrays, manifest)


def drive_segments(world: World, settings: SimSettings, rng: np.random.Generator, progress: Report) -> PlanarDrive:
    """Drive straight segments from wall to wall, with random headings (paper, Sec. IV-A)."""
    drive, wanted = settings.drive, world.segments
    place, yaw, angle, clock = world.draw_start(rng), 0.0, np.zeros(2), 0.0
    pose, reading, angles, times = [np.array([*place, yaw])], [], [], []
    turned, kinds = list[np.ndarray](), list[int]()
    for segment in range(wanted):
        relocated = segment and world.relocate_after and segment % world.relocate_after == 0
        if relocated:
            place = world.draw_start(rng)
            pose.append(np.array([*place, yaw]))
        heading, steps = choose_heading(world, place, drive.spacing_m, drive.longest_m, rng)
        kinds.append(KINDS.index("relocated" if relocated else "in_place"))
        if segment and not relocated:
            turned.append(np.array([*place, heading]))
        turn = wrap(heading - yaw)
        along = drive.spacing_m * np.arange(steps + 1)
        points = place + along[:, None] * [np.cos(heading), np.sin(heading)]
        angle = angle + np.array([-turn, turn]) * TRACK_M / 2 / WHEEL_RADIUS_M
        clock += abs(turn) / TURN_RATE_RPS
        observation = len(pose) - 1 + np.arange(steps + 1)
        pose.extend(np.column_stack([points[1:], np.full(steps, heading)]))
        reading.append(np.column_stack([np.full(steps + 1, segment), observation]))
        angles.append(angle + along[:, None] / WHEEL_RADIUS_M)
        times.append(clock + along / drive.speed_mps)
        place, yaw, angle, clock = points[-1], heading, angles[-1][-1], times[-1][-1]
        share = min(1.0, max((segment + 1) / wanted, len(pose) / drive.samples))
        progress("drive", round(share * drive.samples), drive.samples)
        if len(pose) >= drive.samples:
            break
    numbers = np.concatenate(reading)
    kept = numbers[:, 1] < drive.samples
    turns = list_turns(numbers[kept, 0], numbers[kept, 1], kinds)
    return PlanarDrive(
        np.array(pose[: drive.samples]),
        numbers[kept],
        np.concatenate(angles)[kept],
        np.concatenate(times)[kept],
        turns,
        np.array(turned).reshape(-1, 3)[: count_images(turns)],
    )


def choose_heading(
    world: World, place: np.ndarray, spacing_m: float, longest_m: float, rng: np.random.Generator
) -> tuple[float, int]:
    """Draw a heading [rad], uniform among those with MIN_STEPS clear spacings or more, and count them.

    Raises WorkError if no such heading is found.
    """
    for _ in range(TRIES):
        heading = rng.uniform(-np.pi, np.pi)
        # A place at the wall may be beyond it by a rounding error.
        steps = int(min(world.way_ahead(place, heading), longest_m) / spacing_m + 1e-9)
        if steps >= MIN_STEPS:
            return heading, steps
    x, y = place
    raise WorkError(
        f"drive.spacing_m {spacing_m} m must be smaller: from ({x:.2f}, {y:.2f}) m, where the robot came, "
        f"no heading of {TRIES} leads {MIN_STEPS} spacings ahead"
    )
