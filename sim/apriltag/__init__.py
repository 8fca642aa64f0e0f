"""AprilTags: their detector, the bundle adjustment that turns detections into labels, and the labels themselves.

Nothing here uses the simulator or the ground truth: images and detections come in, poses go out.
"""
