"""Positioning methods: DeepGPS, its variants and its rivals, all listed in ``catalog``.

Only the supervised rivals learn from positions: a recording's labels or the simulator's truth.
"""
