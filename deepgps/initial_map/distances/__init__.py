"""The initial map from distances driven alone."""
