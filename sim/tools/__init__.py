"""Tools around the simulator: a gallery of rooms, a rendering benchmark, and a check of this machine.

Nothing else imports these modules.
"""
