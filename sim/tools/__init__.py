"""Tools around the simulator: a gallery of rooms, and a check of this machine.

Nothing else imports these modules.
"""
