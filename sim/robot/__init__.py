"""The differential-drive robot: its model, its range finders, how it drives, and the scene it drives in.

What it senses for learning is in ``sim.sensors``; neither package imports the other.
"""
