"""The differential-drive robot: its model, its range finders, how it drives, and the scene it drives in.

The sensors for learning are in ``sim.sensors``, which never imports this package; of it, this one imports only the
catalog, to mount the sensors.
"""
