"""Chunks of a drive: each holds the robot's states and everything needed to drive on."""

import json

import numpy as np

from sim.recording.turns import KINDS
from sim.robot.drive import DriveMode, Segment, next_segment
from sim.robot.headings import Visits
from sim.robot.world import RoomWorld
from sim.settings import SimSettings

CHUNK = 256
"""Fewest new observations in a chunk, except in the last one of a drive."""


def drive_chunk(
    world: RoomWorld, settings: SimSettings, rng: np.random.Generator, before: dict[str, np.ndarray] | None
) -> dict[str, np.ndarray]:
    """Drive the next chunk; the chunk ``before`` holds everything that it depends on."""
    if before is None:
        world.start(rng)
        segments = observations = 0
        mode = DriveMode()
    else:
        world.set_state(before["world_state"])
        rng.bit_generator.state = json.loads(str(before["rng_state"]))
        segments, observations = int(before["segments"]), int(before["observations"])
        mode = DriveMode(bool(before["continues"]), before["mode"].item(), int(before["side"]))
    visits = Visits(world.body, world.wheel_angle())
    if before and "visit_angle" in before:  # a drive with random headings may have begun before there were visits
        visits.set_state(before)
    first, driven, dropped, relocated = observations, list[dict[str, np.ndarray]](), 0, 0
    wanted = settings.drive.samples + settings.grid.held_out
    while observations - first < CHUNK and observations < wanted:
        segment = next_segment(world, settings.drive, rng, mode, visits)
        driven.append(_number(segment, segments, observations))
        observations += len(driven[-1]["state"])
        segments, mode = segments + 1, segment.mode
        dropped += segment.dropped
        relocated += segment.relocated
    return {
        **{name: np.concatenate([one[name] for one in driven]) for name in driven[0]},
        "dropped": np.array(dropped),
        "relocated": np.array(relocated),
        "segments": np.array(segments),
        "observations": np.array(observations),
        "continues": np.array(mode.continues),
        "mode": np.array(mode.kind),
        "side": np.array(mode.side),
        **visits.state(),
        "world_state": world.state(),
        "rng_state": np.array(json.dumps(rng.bit_generator.state)),
    }


def _number(segment: Segment, number: int, observations: int) -> dict[str, np.ndarray]:
    """A segment's new states and its readings, numbered over the complete drive."""
    first = observations - 1 if segment.continues else observations
    count = len(segment.time)
    return {
        "state": segment.state[1:] if segment.continues else segment.state,
        "turn_state": segment.state[: segment.continues],
        "turn_kind": np.array([_name_turn(segment)]),
        "segment": np.full(count, number),
        "observation": np.arange(first, first + count),
        "wheel_angle": segment.wheel_angle,
        "time": segment.time,
    }


def _name_turn(segment: Segment) -> int:
    """Number of the kind of the turn before a segment."""
    if segment.relocated or segment.after_arc:
        return KINDS.index("relocated")
    return KINDS.index("in_place" if segment.continues else "backed_off")
