"""Sensors for learning: fisheye and tag camera, lidar, wheel encoders, and the faults of each.

A sensor is given its pose and never decides where the robot goes.
"""
