"""What a recording becomes for learning: plausible readings, segments with distances, features, encoder noise, labels.

Only ``labels`` opens the truth, for rivals that are supervised by it.
"""
