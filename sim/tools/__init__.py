"""Commands around the simulator: a gallery of rooms, a benchmark of rendering, and a check of this machine.

Nothing else imports these modules.
"""
