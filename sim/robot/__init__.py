"""The differential-drive robot: its model, its range finders, how it drives, and the scene it drives in.

The sensors for learning are in ``sim.sensors``; neither package imports the other.
"""
