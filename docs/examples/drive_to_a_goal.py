"""A robot drives to a goal by its own positions: the run's navigator, in a loop of one's own."""

import numpy as np

import deepgps
from deepgps.navigation.navigator import Senses
from sim.environment import RoomEnvironment
from sim.robot.model import wheel_speeds
from sim.robot.range_finder import clear_length

run = deepgps.simulate("tiny", methods=["registration"], settings={"encoder.slip_per_m": 0.0})
robot, navigator = RoomEnvironment(run.scenario.sim, np.random.default_rng(0)), run.navigator()
seen, floor = robot.reset().observation, navigator.floor

# Goals are in the method's own frame: here the place on driven floor that is farthest from its edge.
row, column = np.unravel_index(floor.edge_m.argmax(), floor.free.shape)
navigator.start(goal := floor.places(np.array([row, column])))
while navigator.outcome is None:
    clear_m, image = clear_length(seen["ranges"]), seen["polar"]
    senses = Senses(seen["ticks"], lambda angle, clear_m=clear_m: clear_m, False, lambda image=image: image)
    command = navigator.step(senses)  # speed [m/s] and turn rate [rad/s] for the next 0.04 s
    seen = robot.step(wheel_speeds(*command)).observation

world = run.alignment()
assert world is not None
away_m = np.linalg.norm(world.apply(goal) - robot.true_pose()[:2])
print(f"arrived: {navigator.outcome.arrived} {navigator.outcome.reason}, {100 * away_m:.1f} cm from the goal")
