"""Runs and studies in the Rerun viewer; only this package imports rerun."""
