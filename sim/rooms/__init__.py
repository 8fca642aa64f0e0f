"""Rooms: outlines, plans, placement of furniture, rooms read from MJCF files, free space, and changes before
deployment.

Nothing here uses the robot or a sensor.
"""
