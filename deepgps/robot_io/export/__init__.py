"""What leaves the testbed: trajectories for other tools, and a trained method as a folder that needs no torch."""
