"""Measures of positioners and encoders against the truth: alignment, error field, metrics.

Training never imports this package.
"""
