"""World, robot, sensors, driving and recording.

Conventions of the project:

- Frames: world x right, y forward, z up; metres, radians, seconds; yaw counter-clockwise from +x;
  quaternions wxyz. Names cancel like fractions: ``T_world_robot @ T_robot_camera``.
- A planar pose is ``(x, y, yaw)``; the robot's origin is on the floor under the middle of its wheel axle, and
  its x axis points forward. The camera looks up along the robot's z axis.
- A polar image has shape ``(rings, sectors, 3)``, uint8 RGB. Ring 0 is nearest to the zenith. Sector ``j`` looks in
  the direction ``2 pi (j + 0.5) / sectors`` counter-clockwise from the robot's own x axis: when the robot
  turns left by ``k`` sectors, the image becomes ``np.roll(image, -k, axis=1)``.
- Names state the unit where it could be unclear: ``_m``, ``_rad``, ``_s``, ``_px``.
- Random generators are arguments: ``rng: np.random.Generator``. No code seeds a global generator.
"""
