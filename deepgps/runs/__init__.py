"""A run's folder: its mark and lock, what it was made from, how it is resumed and listed."""
