"""Positioning methods, how each learns: DeepGPS, its variants and its baselines, listed in ``config.methods``."""
