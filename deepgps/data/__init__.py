"""Training data from a recording: checked readings, segments with distances, features, encoder noise, labels."""
