"""What a trained method gives: position, yaw, radius and acceptance of one observation; saved and loaded."""
