"""The drive of a recording, repeated with all states between its samples."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from sim.recording.chunks import drive_chunk
from sim.rng import stream
from sim.robot.model import WHEELS
from sim.robot.world import RoomWorld
from sim.robot_log.clocks import Clock
from sim.rooms.spec import PREFIX
from sim.settings import DeploymentSettings, SimSettings


class TracedWorld(RoomWorld):
    """A room that keeps the state after each time step of its physics, which goes on bit for bit as without."""

    def __init__(self, settings: SimSettings, room: mujoco.MjSpec | None = None) -> None:
        super().__init__(settings.model_copy(update={"deployment": DeploymentSettings()}), room, drawn=False)
        self.wheels = [self.model.joint(PREFIX + name).qposadr[0] for name in WHEELS]
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
    """A stretch of the drive, as long as a recording's chunk.

    Attributes:
        begun: Time at its beginning [s].
        time: Time after each step of the physics (n,) [s].
        state: Full positions then (n, nq).
        observations: Number of the recording's observations up to its end.
        wheel_angle: Wheel angles at the recording's readings in it (r, 2) [rad].
    """

    begun: float
    time: np.ndarray
    state: np.ndarray
    observations: int
    wheel_angle: np.ndarray

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
