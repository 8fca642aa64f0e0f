"""Learn positions from images and distances driven, evaluate what was learned, and show it."""
