"""An adversary of the testbed: it breaks files, disks and processes, and counts what the commands make of it.

``python -m tests.faults`` (``make faults``) takes some ten minutes on two cores and is no part of ``make test``. It
uses the product through its command line alone, so that it shares no mistake with it. Every draw follows from
``--seed``.
"""
