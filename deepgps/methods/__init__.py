"""Positioning methods: DeepGPS, its variants and its rivals, all listed in ``catalog``.

Only the supervised rivals see labels, and none sees the truth.
"""
