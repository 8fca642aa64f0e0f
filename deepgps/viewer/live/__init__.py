"""The recording of a run that is still working, sent to a viewer as the stages report progress.

It listens to the stages and never delays or changes them.
"""
