"""What the robot senses for learning: fisheye and tag camera, lidar, wheel encoders, and the faults of each.

A sensor is told where it is and never decides where the robot goes.
"""
