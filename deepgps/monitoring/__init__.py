"""Why images of a drive in use are refused: checks of single images, comparison with training images, and rules.

Nothing here opens the truth: thresholds are quantiles of the training images' own figures.
"""
