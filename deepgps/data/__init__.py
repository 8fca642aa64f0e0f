"""Training data from a recording: plausible readings, segments with distances, features, encoder noise, labels.

Only ``labels`` opens the ground truth, for the supervised baselines.
"""
