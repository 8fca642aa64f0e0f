"""``deepgps bench``: speed, memory and the paper's figures, next to those of an earlier bench.

Tests never time anything; what must stay fast is measured here.
"""
