"""Recordings: their format on disk, the renderers that make them in parallel, and recordings derived from others.

What the robot sensed and the truth are kept in separate files; nothing here learns.
"""
