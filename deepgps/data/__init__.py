"""Training data from a recording: checked readings, segments with distances, features, encoder noise, labels.

Only ``labels`` opens the ground truth, for the supervised baselines.
"""
