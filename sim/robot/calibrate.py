"""Calibration: wheel radius and track of the compiled robot, each from one drive on an empty floor."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from sim.errors import InputError, shorten
from sim.robot.chassis import Chassis
from sim.robot.model import BURGER, CONTROL_PERIOD_S, TRACK_M, WHEEL_RADIUS_M, Body, wheel_speeds
from sim.robot.own import describe_own
from sim.rooms.mjcf_files import list_files
from sim.rooms.spec import empty_room
from sim.settings import TURN_RATE_RPS, DriveSettings, RobotSettings, SimSettings

RAMP_S = 0.5  # Time in which a test drive speeds up and slows down [s]
STRAIGHT_M, MIN_STRAIGHT_M = 5.0, 4.0
"""Length of the straight test drive, and what a robot that can be used drives of it at least [m]."""


def calibrate(settings: SimSettings, body: Body = BURGER) -> tuple[float, float]:
    """Measure the values that WHEEL_RADIUS_M and TRACK_M of sim/robot/model.py should have.

    Args:
        settings: The robot is used.
        body: Its dimensions, roughly.

    Returns:
        Effective wheel radius [m]: distance travelled on a 5 m straight over the mean wheel angle; and effective track
        [m]: difference of the distances of the wheels over the angle turned in four turns in place.

    Raises:
        InputError: The robot hardly moves.
    """
    world = Chassis(settings, empty_room(), body)
    world.place(np.zeros(3))
    run(world, settings.drive.speed_mps, 0.0, STRAIGHT_M / settings.drive.speed_mps)
    driven_m = float(np.hypot(*world.pose()[:2]))
    if not driven_m > MIN_STRAIGHT_M:  # NaN is not
        raise InputError(
            f"robot.mjcf {shorten(str(settings.robot.mjcf), 300)}: told to drive {STRAIGHT_M:g} m at drive.speed_mps "
            f"{settings.drive.speed_mps:g}, it drove {driven_m:.2g} m; its wheels must touch the floor, and its motors "
            "must be strong and fast enough"
        )
    radius_m = float(driven_m / world.wheel_angle().mean())
    world.place(np.zeros(3))
    yaw = run(world, 0.0, TURN_RATE_RPS, 8 * np.pi / TURN_RATE_RPS)
    left, right = world.wheel_angle()
    return radius_m, float((right - left) * radius_m / np.unwrap(yaw)[-1])


def calibrate_own(settings: SimSettings) -> Body:
    """Dimensions of a user's own robot: size from its geoms, wheel radius and track from two drives."""
    path = Path(settings.robot.mjcf or "")
    list_files(path, "robot")
    return _calibrate_once(settings.robot.model_dump_json(), path.read_bytes(), settings.drive.speed_mps)


@lru_cache(maxsize=8)
def _calibrate_once(settings: str, content: bytes, speed_mps: float) -> Body:
    robot, drive = RobotSettings.model_validate_json(settings), DriveSettings(speed_mps=speed_mps)
    body = describe_own(robot)
    radius_m, track_m = calibrate(SimSettings(robot=robot, drive=drive), body)
    return replace(body, wheel_radius_m=radius_m, track_m=track_m)


def run(world: Chassis, speed_mps: float, turn_rate_rps: float, duration_s: float) -> np.ndarray:
    """Drive with ramps at both ends, then pause for a moment; return the yaw (n,) after each period [rad]."""
    period = CONTROL_PERIOD_S
    periods, ramp = round((duration_s + RAMP_S) / period), round(RAMP_S / period)
    yaw = [world.pose()[2]]
    for i in range(periods + ramp):
        share = np.clip(min(i + 1, periods - i) / ramp, 0.0, 1.0)
        world.step(share * wheel_speeds(speed_mps, turn_rate_rps, world.body))
        yaw.append(world.pose()[2])
    return np.array(yaw)


if __name__ == "__main__":
    measured = calibrate(SimSettings())
    print(f"WHEEL_RADIUS_M = {measured[0]:.6f}  (stored {WHEEL_RADIUS_M})")
    print(f"TRACK_M = {measured[1]:.6f}  (stored {TRACK_M})")
