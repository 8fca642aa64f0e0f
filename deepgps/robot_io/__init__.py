"""Logs of real robots in; poses, trajectories and models out."""
