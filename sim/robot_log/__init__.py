"""Logs as a robot's computers would have recorded them, by TurtleBot3's conventions: a recording's drive, repeated."""
