"""The recording of one run: the room, the drive, the encoders, the training, the error fields.

The package reads a complete run and writes only ``run.rrd``.
"""
