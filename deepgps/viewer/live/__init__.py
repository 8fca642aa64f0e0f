"""The live recording of a run in progress, sent to a viewer as the stages report progress.

The package listens to the stages and never delays or changes them.
"""
