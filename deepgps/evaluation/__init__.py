"""Evaluation of positioners and encoders against the truth: error field, metrics, segment errors, visibility.

Training never imports this package.
"""
