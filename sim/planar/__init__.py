"""Worlds without MuJoCo: a point robot on a plane with landmarks or obstacles, recorded in the format of the rooms.

Nothing here renders or simulates contacts.
"""
