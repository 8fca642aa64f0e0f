"""Learning to position from images and distances driven; measuring and showing it."""
