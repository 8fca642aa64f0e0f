"""A controller of one's own: drive straight, turn at obstacles, record; then learn, with noisy encoders."""

import sys

import numpy as np

import deepgps
from sim.environment import RoomEnvironment
from sim.robot.model import wheel_speeds
from sim.robot.range_finder import clear_length
from sim.sensors.encoder import read_encoders
from sim.settings import CameraSettings, EncoderSettings, RoomSettings, SimSettings

samples, rng = int(sys.argv[1]) if len(sys.argv) > 1 else 1500, np.random.default_rng(0)
room, camera = RoomSettings(kind="bedroom", width_m=3.2, depth_m=2.8), CameraSettings(rings=16, sectors=64, face_px=32)
robot = RoomEnvironment(SimSettings(room=room, camera=camera), rng, episode_s=1e6, step_s=0.4)
seen, segment, log = robot.reset().observation, 0, []
while len(log) < samples:
    log.append((seen["polar"], robot.true_pose(), robot.wheel_angle(), robot.physics.time(), (segment, len(log))))
    ahead_m = clear_length(seen["ranges"])
    if ahead_m <= 0.15:  # a new segment, once there is room
        segment += 1
    while ahead_m <= 0.15:
        ahead_m = clear_length(robot.step(wheel_speeds(0.0, rng.uniform(1.0, 2.5))).observation["ranges"]) - 0.25
    seen = robot.step(wheel_speeds(0.2, 0.0)).observation
images, poses, angles, times, numbers = (np.array(column) for column in zip(*log, strict=True))

# The noise is drawn for the complete drive, and the robot's builder knows of it.
odometry, encoder = {**robot.odometry, "step_noise": 0.02}, EncoderSettings(step_noise=0.02)
ticks, arrived = read_encoders(angles, odometry["wheel_radius_m"], encoder, rng)
readings, n = np.column_stack([numbers, ticks])[arrived], samples * 9 // 10
kept = readings[:, 1] < n  # the last tenth of the drive is for tests
folder = deepgps.write_recording(
    "my_drive", images[:n], readings[kept], times[arrived][kept], odometry,
    pose=poses[:n], test_observations=images[n:], test_pose=poses[n:],
)  # fmt: skip
run = deepgps.train(folder, ["deepgps", "knn"], settings={"learn.train.steps": 500, "learn.network.width": 128})
print({name: f"{100 * run.metrics['methods'][name]['rms_m']:.1f} cm RMS" for name in run.methods})
