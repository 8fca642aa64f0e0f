"""Calibration: wheel radius and track of the compiled robot, each from one drive on an empty floor.

Before, a user's own robot is test-driven there: one that tips, slips or curves is refused.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sim.errors import InputError, WorkError, shorten
from sim.robot.chassis import Chassis
from sim.robot.drive import STRAIGHTENING_GAIN_PER_S
from sim.robot.model import BASE, BURGER, CONTROL_PERIOD_S, TRACK_M, WHEEL_RADIUS_M, WHEELS, Body, wheel_speeds
from sim.robot.motion import ACCELERATION_MPS2, GOAL_TOLERANCE_M, halt, ramp, travelled, turn
from sim.robot.own import describe_own, find_reach
from sim.rooms.mjcf_files import list_files
from sim.rooms.spec import ROBOT_PREFIX, empty_room
from sim.settings import TURN_RATE_RPS, DriveSettings, RobotSettings, SimSettings

RAMP_S = 0.5  # Time in which a drive of the calibration speeds up and slows down [s]
STRAIGHT_M, TURN_RAD = 5.0, 4.0 * np.pi  # Length of a straight drive [m], and angle of a turn of the test drive [rad]


def calibrate(settings: SimSettings, body: Body = BURGER) -> tuple[float, float]:
    """Measure the values that WHEEL_RADIUS_M and TRACK_M of sim/robot/model.py should have, for a robot of about these
    dimensions.

    The effective wheel radius [m] is the distance travelled on a 5 m straight over the mean wheel angle, the effective
    track [m] the difference of the distances of the wheels over the angle turned in four turns in place.
    """
    world = Chassis(settings, empty_room(), body)
    world.place(np.zeros(3))
    run(world, settings.drive.speed_mps, 0.0, STRAIGHT_M / settings.drive.speed_mps)
    driven_m = float(np.hypot(*world.pose()[:2]))
    radius_m = float(driven_m / world.wheel_angle().mean())
    world.place(np.zeros(3))
    yaw = run(world, 0.0, TURN_RATE_RPS, 8 * np.pi / TURN_RATE_RPS)
    left, right = world.wheel_angle()
    return radius_m, float((right - left) * radius_m / np.unwrap(yaw)[-1])


def calibrate_own(settings: SimSettings) -> Body:
    """Dimensions of a user's own robot: size from its geoms, wheel radius and track from two drives.

    Raises InputError if it is refused, by what it has or by how it drives.
    """
    path = Path(settings.robot.mjcf or "")
    list_files(path, "robot")
    return _calibrate_once(settings.robot.model_dump_json(), path.read_bytes(), settings.drive.speed_mps)


@lru_cache(maxsize=8)
def _calibrate_once(settings: str, content: bytes, speed_mps: float) -> Body:
    robot, drive = RobotSettings.model_validate_json(settings), DriveSettings(speed_mps=speed_mps)
    body = describe_own(robot)
    try_out(whole := SimSettings(robot=robot, drive=drive), body)
    radius_m, track_m = calibrate(whole, body)
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


MAX_LEAN_DEG, MAX_YAW_DEG, MAX_SLIP, MAX_OFF_S = 3.0, 1.0, 0.02, 0.1
"""Largest pitch or roll, yaw after a straight drive, relative slip, and time for which a wheel is off the floor."""
MAX_SUDDEN_M, SUDDEN_S = 0.008, 1.0
"""Largest slip within so long on a straight drive: a tenth of a usual gap between images. What slips as the robot
starts may come back as it brakes."""
MAX_GAP_M = 0.001  # A wheel is on the floor if it is not further from it [m]
PATIENCE = 1.5  # A straight drive is given up after this times as long as it should take
SKID_FRICTION = 0.1  # Largest friction of a part that slides on the floor as a caster
CASTERS = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE)


def try_out(settings: SimSettings, body: Body) -> None:
    """Drive a user's own robot straight, both ways, and turn it, both ways, from rest to rest as the drive does.

    Raises InputError with a figure and the likely cause if it does not stay on its wheels, slips or curves.
    """
    try:
        fault = next(_find_faults(_Watched(settings, empty_room(), body)), None)
    except WorkError as error:
        fault = f"in its test drive, {error}"
    if fault:
        raise InputError(f"robot.mjcf {shorten(str(settings.robot.mjcf), 300)}: {fault}")


def _find_faults(world: Any) -> Iterator[str]:
    speed_mps, limited = world.settings.drive.speed_mps, world.model.actuator_ctrllimited > 0
    needed_rps = speed_mps / world.body.wheel_radius_m
    most_rps = np.abs(world.model.actuator_ctrlrange[limited]).min(initial=np.inf)
    told = f"told to drive {STRAIGHT_M:g} m at drive.speed_mps {speed_mps:g}, it"
    causes = "too little mass or friction on them for the motors, or a caster that drags"
    if most_rps < needed_rps:
        yield f"{told} needs wheels that turn at {needed_rps:.3g} rad/s, and their ctrlrange ends at {most_rps:g}"
    for way in (1.0, -1.0):
        yield from world.watch(partial(_drive_straight, world, way))
        rolled_m, driven_m = abs(world.wheel_angle().mean()) * world.axle_m, np.hypot(*world.pose()[:2])
        if rolled_m < (1.0 - MAX_SLIP) * STRAIGHT_M:
            yield f"{told} rolled {rolled_m:.2g} m: its motors are too weak (kv, forcerange), or a caster drags"
        slip, yaw_deg = abs(driven_m / rolled_m - 1.0), np.degrees(world.pose()[2])
        if not slip <= MAX_SLIP:  # NaN is not
            yield f"{told} drove {driven_m:.3g} m: its wheels slip by {100.0 * slip:.1f} % ({causes})"
        if abs(yaw_deg) > MAX_YAW_DEG:
            yield f"{told} turned by {yaw_deg:.2g} degrees: its wheels differ (axis, radius) or slip ({causes})"
        if (sudden_m := world.find_sudden_slip()) > MAX_SUDDEN_M:
            sudden = f"{1000.0 * sudden_m:.0f} mm within {SUDDEN_S:g} s"
            yield f"its wheels slip by {sudden}, as it starts or brakes ({causes})"
    for way in (1.0, -1.0):
        yield from world.watch(partial(turn, world, way * TURN_RAD))


def _drive_straight(world: Any, way: float) -> None:
    highest, now, rest, start = world.settings.drive.speed_mps, 0.0, STRAIGHT_M, world.wheel_angle()
    while rest > GOAL_TOLERANCE_M and world.time() < PATIENCE * STRAIGHT_M / highest:
        now = ramp(now, highest, ACCELERATION_MPS2, rest, CONTROL_PERIOD_S)
        even = STRAIGHTENING_GAIN_PER_S * (world.wheel_angle() @ (1.0, -1.0)) / 2
        world.step(wheel_speeds(way * now, 0.0, world.body) + (-even, even))
        rest = STRAIGHT_M - abs(travelled(world, start))
    halt(world)


class _Watched(Chassis):
    """A robot on an empty floor of which each step notes how it stands."""

    def watch(self, drive: Callable[[], object]) -> Iterator[str]:
        """Drive from the origin; how the robot did not stand on its wheels."""
        self.place(np.zeros(3))
        model, self._joints = self.model, [self.model.joint(ROBOT_PREFIX + name).id for name in WHEELS]
        self.axle_m = float(self.data.xanchor[self._joints, 2].mean())  # its height
        part = model.body_weldid[model.geom_bodyid]
        slides = (model.geom_condim == 1) | (model.geom_friction[:, 0] <= SKID_FRICTION)
        body = (part == model.body(ROBOT_PREFIX + BASE).id) & ~np.isin(model.geom_type, CASTERS) & ~slides
        self._lean_deg, self._leans, self._speed, self._on_floor = 0.0, "", 0.0, set[int]()
        self._off_s = self._longest_off_s = np.zeros(2)
        self._ahead_m = list[float]()  # How much further the wheels rolled than the robot drove, after each step
        drive()
        mass = f"its mass of {mujoco.mj_getTotalmass(model):.2g} kg is too small for its motors (kv, forcerange)"
        if self._leans:
            where = "in front" if "forward" in self._leans else "behind" if "rears" in self._leans else "aside"
            yield f"{self._leans}, by {self._lean_deg:.0f} degrees: {mass}, or a caster is missing {where}"
        for geom in [geom for geom in self._on_floor if body[geom]]:
            name = shorten(model.geom(geom).name.removeprefix(ROBOT_PREFIX)) or "without a name"
            yield f'its body (geom {name}) touches the floor: a caster is a sphere, or slides (condim="1")'
        for side, off_s in zip(("left", "right"), self._longest_off_s, strict=True):
            if off_s > MAX_OFF_S:
                yield f"its {side} wheel is off the floor for {off_s:.2g} s: a caster is too low, or {mass}"

    def step(self, wheel_speed: np.ndarray) -> None:
        """Drive the wheels for one control period, and note how the robot stands."""
        super().step(wheel_speed)
        before, self._speed = self._speed, float(np.abs(wheel_speed).sum())
        w, i, j, k = self.data.qpos[3:7]
        pitch, roll = np.degrees(np.arcsin(np.clip((2 * (w * j - k * i), 2 * (w * i + j * k)), -1.0, 1.0)))
        self._lean_deg = max(self._lean_deg, abs(pitch), abs(roll))
        if self._lean_deg > MAX_LEAN_DEG and not self._leans:  # how it begins tells why
            way = "leans aside" if abs(roll) > abs(pitch) else "tips forward" if pitch > 0.0 else "rears up"
            does = "brakes" if self._speed < before else "starts" if self._speed > before else "drives"
            self._leans = f"it {way} when it {does}{' backward' * bool((wheel_speed < 0.0).all())}"
        floor, pairs = self.model.geom("floor").id, self.data.contact.geom
        on_floor = pairs[(pairs == floor).any(axis=1)].sum(axis=1) - floor
        self._on_floor |= set(on_floor.tolist())
        above_m = [-find_reach(self.model, self.data, -np.eye(3)[2:], joint)[0] for joint in self._joints]
        self._off_s = (self._off_s + CONTROL_PERIOD_S) * (np.array(above_m) > MAX_GAP_M)
        self._longest_off_s = np.maximum(self._longest_off_s, self._off_s)
        rolled_m, driven_m = abs(self.wheel_angle().mean()) * self.axle_m, np.hypot(*self.pose()[:2])
        self._ahead_m.append(float(rolled_m - driven_m))

    def find_sudden_slip(self) -> float:
        """Largest slip within ``SUDDEN_S`` of the last straight drive [m]."""
        ahead_m, steps = np.array(self._ahead_m), round(SUDDEN_S / CONTROL_PERIOD_S)
        return float(np.abs(ahead_m[steps:] - ahead_m[:-steps]).max())


if __name__ == "__main__":
    measured = calibrate(SimSettings())
    print(f"WHEEL_RADIUS_M = {measured[0]:.6f}  (stored {WHEEL_RADIUS_M})")
    print(f"TRACK_M = {measured[1]:.6f}  (stored {TRACK_M})")
