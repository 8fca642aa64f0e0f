"""Recordings: their format on disk, the renderers that make them in parallel, and recordings derived from others.

Sensor data and ground truth are kept in separate files; nothing here learns.
"""
