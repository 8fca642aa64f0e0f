"""Tracking: single poses and odometry fused over a drive, while it is driven (filter) and afterwards (smoother).

All but ``drive`` and ``track`` need NumPy alone, so that they run on a robot. Nothing here opens the truth or an
alignment: all poses are in the method's own frame.
"""
