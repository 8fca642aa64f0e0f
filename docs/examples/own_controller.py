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
seen = robot.reset().observation
images, poses, rows, angles, times, segment = [], [], [], [], [], 0
while len(images) < samples:
    rows.append((segment, len(images)))
    images.append(seen["polar"]), poses.append(robot.true_pose())
    angles.append(robot.wheel_angle()), times.append(robot.physics.time())
    ahead_m = clear_length(seen["ranges"])
    if ahead_m <= 0.15:  # a new segment, once there is room
        segment += 1
    while ahead_m <= 0.15:
        ahead_m = clear_length(robot.step(wheel_speeds(0.0, rng.uniform(1.0, 2.5))).observation["ranges"]) - 0.25
    seen = robot.step(wheel_speeds(0.2, 0.0)).observation

noise = {"step_noise": 0.02}  # drawn for the complete drive
ticks, arrived = read_encoders(np.array(angles), robot.odometry["wheel_radius_m"], EncoderSettings(**noise), rng)
readings, time, count = np.column_stack([rows, ticks])[arrived], np.array(times)[arrived], samples * 9 // 10
kept, odometry = readings[:, 1] < count, {**robot.odometry, **noise}
tests = {"test_observations": images[count:], "test_pose": poses[count:], "pose": poses[:count]}
folder = deepgps.write_recording("my_drive", images[:count], readings[kept], time[kept], odometry, **tests)
run = deepgps.train(folder, ["deepgps", "knn"], settings={"learn.train.steps": 500, "learn.network.width": 128})
for name in run.methods:
    print(f"{name}: {100 * run.metrics['methods'][name]['rms_m']:.1f} cm RMS")
