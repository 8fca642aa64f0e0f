"""Worlds without MuJoCo: a point robot on a plane with landmarks or obstacles, recorded in the same format.

Nothing here renders or simulates contacts.
"""
