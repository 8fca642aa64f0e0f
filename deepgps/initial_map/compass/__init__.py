"""The initial map from distances and the visual compass."""
