"""Rooms: outlines, plans, placement of furniture, rooms read from MJCF files, free space, and changes before
deployment.

A room knows no robot and no sensor.
"""
