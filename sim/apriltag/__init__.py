"""AprilTags: their detector, the bundle adjustment that turns detections into labels, and the labels themselves.

Nothing here knows the simulator or the truth: images and detections come in, poses go out.
"""
