"""Positioning methods: DeepGPS, its variants and its rivals, all listed in ``catalog``.

Only the supervised rivals use positions: a recording's labels, or the truth if it has none.
"""
