"""``deepgps bench``: speed, memory and the paper's figures, in pairs with earlier measurements.

Tests never time anything; what must stay fast is measured here.
"""
