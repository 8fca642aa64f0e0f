"""Positioning methods: DeepGPS, its variants and its baselines, all listed in ``catalog``.

Only the supervised baselines learn from positions: a recording's labels or the simulator's truth.
"""
