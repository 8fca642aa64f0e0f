"""Recordings for the Rerun viewer: of a run, of a pair of runs, of a study, and of work in progress.

This is the only package that imports Rerun; it reads the files of other packages and computes no results.
"""
