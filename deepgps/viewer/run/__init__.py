"""The recording of one run: the room, the drive, the encoders, the training, the error fields.

It reads a complete run and writes nothing but ``run.rrd``.
"""
