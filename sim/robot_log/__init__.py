"""Logs: what a robot's ROS 2 computer would have recorded of a drive, written as MCAP.

A log is made from a recording's settings: the same drive is repeated, bit for bit, and observed continuously. Names,
types and rates follow TurtleBot3's conventions (ROBOTIS-GIT/turtlebot3, turtlebot3_node and turtlebot3_bringup).
"""
