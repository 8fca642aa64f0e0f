"""Calibration: wheel radius and track of the compiled robot, each from one drive on an empty floor."""

import numpy as np

from sim.robot.model import CONTROL_PERIOD_S, TRACK_M, WHEEL_RADIUS_M, wheel_speeds
from sim.robot.world import RoomWorld
from sim.rooms.spec import empty_room
from sim.settings import SimSettings

RAMP_S = 0.5
"""Time in which a test drive speeds up and slows down [s]."""


def calibrate(settings: SimSettings) -> tuple[float, float]:
    """Measure the values that WHEEL_RADIUS_M and TRACK_M of sim/robot/model.py should have.

    Returns:
        Effective wheel radius [m]: distance travelled on a 5 m straight over the mean wheel angle; and effective track
        [m]: difference of the distances of the wheels over the angle turned in four turns in place.
    """
    world = RoomWorld(settings, empty_room())
    world.place(np.zeros(3))
    run(world, settings.drive.speed_mps, 0.0, 5.0 / settings.drive.speed_mps)
    x, y, _ = world.pose()
    radius_m = float(np.hypot(x, y) / world.wheel_angle().mean())
    world.place(np.zeros(3))
    yaw = run(world, 0.0, settings.drive.turn_rate_rps, 8 * np.pi / settings.drive.turn_rate_rps)
    left, right = world.wheel_angle()
    return radius_m, float((right - left) * radius_m / np.unwrap(yaw)[-1])


def run(world: RoomWorld, speed_mps: float, turn_rate_rps: float, duration_s: float) -> np.ndarray:
    """Drive with ramps at both ends, then pause for a moment; return the yaw (n,) after each period [rad]."""
    period = CONTROL_PERIOD_S
    periods, ramp = round((duration_s + RAMP_S) / period), round(RAMP_S / period)
    yaw = [world.pose()[2]]
    for i in range(periods + ramp):
        share = np.clip(min(i + 1, periods - i) / ramp, 0.0, 1.0)
        world.step(share * wheel_speeds(speed_mps, turn_rate_rps))
        yaw.append(world.pose()[2])
    return np.array(yaw)


if __name__ == "__main__":
    measured = calibrate(SimSettings())
    print(f"WHEEL_RADIUS_M = {measured[0]:.6f}  (stored {WHEEL_RADIUS_M})")
    print(f"TRACK_M = {measured[1]:.6f}  (stored {TRACK_M})")
