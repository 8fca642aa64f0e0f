"""The recording of a study: every run's error field, with sliders for what was varied.

It reads the study's table and its runs and measures nothing again.
"""
