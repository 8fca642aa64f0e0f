"""Logs of real robots: ROS 1 bags, ROS 2 db3 and MCAP, and plain folders, imported as recordings."""
