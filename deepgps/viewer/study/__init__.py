"""The recording of a study: every run's error field, with sliders for what was varied.

The package reads the study's table and runs and measures nothing again.
"""
